//! Says so where `[keep]` or `[reject]` names no photo of the run.

use std::collections::{BTreeMap, BTreeSet};

use marf_stage::Verdict;

use super::session::NodeInfo;

/// Verdicts of files from which no photo came.
const NO_PHOTO: [&str; 2] = ["decode", "skipped"];

/// Returns one line for each name in a list of the filters that moved nothing: unknown, or no photo came of it.
pub fn idle(nodes: &[NodeInfo], verdicts: &[Verdict]) -> Vec<String> {
    let mut known: BTreeMap<&str, Vec<&Verdict>> = BTreeMap::new();
    for verdict in verdicts {
        known.entry(&verdict.id).or_default().push(verdict);
        known.entry(&verdict.file).or_default().push(verdict);
    }
    let complain = |(list, name): (&str, &str)| match known.get(name) {
        None => Some(format!(
            "[{list}] `{name}` names no photo of this run{}",
            near(name, known.keys())
        )),
        Some(verdicts) => verdicts
            .iter()
            .all(|verdict| NO_PHOTO.contains(&verdict.verdict.as_str()))
            .then(|| format!("[{list}] no photo came of `{name}`: {}", verdicts[0].reason)),
    };
    named(nodes).into_iter().filter_map(complain).collect()
}

/// The names in the lists of all filters, each once.
fn named(nodes: &[NodeInfo]) -> BTreeSet<(&str, &str)> {
    let lists = nodes.iter().flat_map(|node| {
        ["keep", "reject"]
            .into_iter()
            .map(|list| (list, &node.params["by_hand"][list]))
    });
    lists
        .flat_map(|(list, names)| {
            let names = names.as_array().into_iter().flatten();
            names.filter_map(move |name| Some((list, name.as_str()?)))
        })
        .collect()
}

fn near<'a>(name: &str, known: impl Iterator<Item = &'a &'a str>) -> String {
    let scored = known.map(|other| (strsim::damerau_levenshtein(name, other), *other));
    match scored.min() {
        Some((distance, other)) if distance <= 1 + name.len() / 4 => format!("; did you mean `{other}`?"),
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(id: &str, verdict: &str) -> Verdict {
        Verdict {
            id: id.to_owned(),
            file: format!("dir/{id}.jpg"),
            verdict: verdict.to_owned(),
            score: None,
            threshold: None,
            twin: None,
            reason: "cut short".to_owned(),
        }
    }

    #[test]
    fn a_name_that_moves_nothing_is_told_once() {
        let node = |name: &str| NodeInfo {
            name: name.to_owned(),
            about: "",
            params: serde_json::json!({"by_hand": {"keep": ["rock_1", "dir/rock_2.jpg", "rokc_2"], "reject": ["torn"]}}),
        };
        let verdicts = [
            verdict("rock_1", "keep"),
            verdict("rock_2", "blur"),
            verdict("torn", "decode"),
        ];
        let lines = idle(&[node("size"), node("blur")], &verdicts);
        assert_eq!(
            lines,
            [
                "[keep] `rokc_2` names no photo of this run; did you mean `rock_2`?",
                "[reject] no photo came of `torn`: cut short",
            ]
        );
        assert!(idle(&[], &verdicts).is_empty());
    }
}

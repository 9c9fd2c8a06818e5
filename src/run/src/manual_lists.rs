//! Warnings about names in `[keep]` and `[reject]` that have no effect.

use std::collections::{BTreeMap, BTreeSet};

use marf_stage::Verdict;

use crate::session::NodeInfo;
use marf_config::manual_entries;
use marf_config::nearest::did_you_mean;

/// Verdicts of files that gave no photo.
const NO_PHOTO: [&str; 2] = ["decode", "skipped"];

/// Returns whether any filter has a name in a list.
pub fn any(nodes: &[NodeInfo]) -> bool {
    nodes
        .iter()
        .any(|node| manual_entries(&node.params).next().is_some())
}

/// Returns one line for each name in a list of the filters that is unknown, or whose file gave no photo.
pub fn without_effect(nodes: &[NodeInfo], verdicts: &[Verdict]) -> Vec<String> {
    let mut known: BTreeMap<&str, Vec<&Verdict>> = BTreeMap::new();
    for verdict in verdicts {
        known.entry(&verdict.id).or_default().push(verdict);
        known.entry(&verdict.file).or_default().push(verdict);
    }
    let warning = |(list, name): (&str, &str)| match known.get(name) {
        None => {
            let hint = did_you_mean(name, known.keys().copied());
            let hint = hint.map(|hint| format!(": {hint}")).unwrap_or_default();
            Some(format!("[{list}] `{name}` names no photo of this run{hint}"))
        }
        Some(verdicts) => verdicts
            .iter()
            .all(|verdict| NO_PHOTO.contains(&verdict.verdict.as_str()))
            .then(|| format!("[{list}] `{name}` gave no photo: {}", verdicts[0].reason)),
    };
    let named: BTreeSet<(&str, &str)> = nodes
        .iter()
        .flat_map(|node| manual_entries(&node.params))
        .collect();
    named.into_iter().filter_map(warning).collect()
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
    fn a_name_without_effect_has_one_warning() {
        let node = |name: &str| NodeInfo {
            name: name.to_owned(),
            about: "",
            relax: None,
            params: serde_json::json!({"by_hand": {"keep": ["rock_1", "dir/rock_2.jpg", "rokc_2"], "reject": ["torn"]}}),
        };
        let verdicts = [
            verdict("rock_1", "keep"),
            verdict("rock_2", "blur"),
            verdict("torn", "decode"),
        ];
        let lines = without_effect(&[node("size"), node("blur")], &verdicts);
        assert_eq!(
            lines,
            [
                "[keep] `rokc_2` names no photo of this run: did you mean `rock_2`?",
                "[reject] `torn` gave no photo: cut short",
            ]
        );
        assert!(without_effect(&[], &verdicts).is_empty());
    }
}

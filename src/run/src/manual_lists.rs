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

/// Most names of a list that have a line each. More have one line together.
const MOST_NAMED: usize = 10;

/// Why a name of a list has no effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum NoEffect {
    /// No file has it.
    Unknown,
    /// Its file gave no photo.
    NoPhoto,
}

/// Returns a line for each name in a list of the filters that is unknown, or whose file gave no photo. Many names have one line.
pub fn without_effect(nodes: &[NodeInfo], verdicts: &[Verdict]) -> Vec<String> {
    let mut known: BTreeMap<&str, Vec<&Verdict>> = BTreeMap::new();
    for verdict in verdicts {
        known.entry(&verdict.id).or_default().push(verdict);
        known.entry(&verdict.file).or_default().push(verdict);
    }
    let fault = |name: &str| match known.get(name) {
        None => Some(NoEffect::Unknown),
        Some(verdicts) => verdicts
            .iter()
            .all(|verdict| NO_PHOTO.contains(&verdict.verdict.as_str()))
            .then_some(NoEffect::NoPhoto),
    };
    let named: BTreeSet<(&str, &str)> = nodes
        .iter()
        .flat_map(|node| manual_entries(&node.params))
        .collect();
    let mut faults: BTreeMap<(&str, NoEffect), Vec<&str>> = BTreeMap::new();
    for (list, name) in named {
        if let Some(fault) = fault(name) {
            faults.entry((list, fault)).or_default().push(name);
        }
    }
    let line = |list: &str, fault: NoEffect, name: &str| match fault {
        NoEffect::Unknown => {
            let hint = did_you_mean(name, known.keys().copied());
            let hint = hint.map(|hint| format!(": {hint}")).unwrap_or_default();
            format!("[{list}] `{name}` names no photo of this run{hint}")
        }
        NoEffect::NoPhoto => format!("[{list}] `{name}` gave no photo: {}", known[name][0].reason),
    };
    let lines = |((list, fault), names): ((&str, NoEffect), Vec<&str>)| match (names.len(), fault) {
        (..=MOST_NAMED, _) => names.into_iter().map(|name| line(list, fault, name)).collect(),
        (count, NoEffect::Unknown) => {
            vec![format!(
                "[{list}] {count} names name no photo of this run, the first is `{}`",
                names[0]
            )]
        }
        (count, NoEffect::NoPhoto) => {
            vec![format!(
                "[{list}] {count} names gave no photo, the first is `{}`",
                names[0]
            )]
        }
    };
    faults.into_iter().flat_map(lines).collect()
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

    #[test]
    fn very_many_names_without_effect_have_one_line() {
        let ids: Vec<String> = (0..900_000).map(|id| format!("id_{id:06}")).collect();
        let node = NodeInfo {
            name: "blur".to_owned(),
            about: "",
            relax: None,
            params: serde_json::json!({"by_hand": {"keep": ids, "reject": ["torn"]}}),
        };
        assert_eq!(
            without_effect(&[node], &[verdict("torn", "decode")]),
            [
                "[keep] 900000 names name no photo of this run, the first is `id_000000`",
                "[reject] `torn` gave no photo: cut short",
            ]
        );
    }
}

//! Decisions of a person on single photos.

use std::collections::BTreeSet;

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::decision::Decision;

/// Photos that a person keeps or rejects. These decisions override the filter.
///
/// Each entry is a product id, or the name of a file as its archive has it. The lists are parameters, hence part of
/// the key of every filter that gets them. No measure depends on them. A photo kept by hand still counts where a
/// filter compares photos with each other, and it is the kept one of a group of duplicates.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ByHand {
    /// Kept at any score.
    pub keep: BTreeSet<String>,
    /// Rejected at any score.
    pub reject: BTreeSet<String>,
}

impl ByHand {
    /// Checks that no name is in both lists.
    ///
    /// # Errors
    /// The name.
    pub(crate) fn check(&self) -> Result<(), ParamError> {
        match self.keep.intersection(&self.reject).next() {
            None => Ok(()),
            Some(both) => Err(ParamError::new(
                "by_hand",
                format!("`{both}` is to be kept and to be rejected: take it out of one list"),
            )),
        }
    }

    /// Whether the photo is kept by hand.
    pub(crate) fn keeps(&self, id: &str, file: &str) -> bool {
        self.keep.contains(id) || self.keep.contains(file)
    }

    /// Returns the decision with the lists applied: score and threshold stay, the reason says who decided.
    pub(crate) fn overrule(&self, id: &str, file: &str, decision: Decision) -> Decision {
        if self.keeps(id, file) {
            let reason = if decision.keep {
                "kept by hand, and by the filter".to_owned()
            } else {
                format!("kept by hand, against the filter: {}", decision.reason)
            };
            return Decision {
                keep: true,
                reason,
                ..decision
            };
        }
        if self.reject.contains(id) || self.reject.contains(file) {
            let reason = if decision.keep {
                "rejected by hand, against the filter".to_owned()
            } else {
                format!("rejected by hand, and by the filter: {}", decision.reason)
            };
            return Decision {
                keep: false,
                reason,
                ..decision
            };
        }
        decision
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(names: &[&str]) -> BTreeSet<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn a_person_has_the_last_word_and_the_filters_word_is_kept() {
        let lists = ByHand {
            keep: list(&["a", "dir/b.jpg"]),
            reject: list(&["c"]),
        };
        let rejected = || Decision::reject(3.0, 9.0, "ratio 3");
        let passed = || Decision::keep(12.0, 9.0);
        let kept = lists.overrule("a", "a.jpg", rejected());
        assert!(
            kept.keep && kept.score == Some(3.0) && kept.reason.contains("ratio 3"),
            "{kept:?}"
        );
        assert!(lists.overrule("b", "dir/b.jpg", rejected()).keep);
        assert!(!lists.overrule("b", "b.jpg", rejected()).keep);
        let gone = lists.overrule("c", "c.jpg", passed());
        assert!(!gone.keep && gone.threshold == Some(9.0) && gone.reason.starts_with("rejected by hand"));
        assert_eq!(lists.overrule("d", "d.jpg", passed()), passed());
    }

    #[test]
    fn a_name_in_both_lists_is_refused() {
        let lists = ByHand {
            keep: list(&["a"]),
            reject: list(&["a"]),
        };
        assert!(lists.check().unwrap_err().message.contains("`a`"));
    }
}

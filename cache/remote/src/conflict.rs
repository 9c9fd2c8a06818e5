//! Two results for one key: the one that was there first stays.

use std::collections::BTreeMap;

use marf_cache::{Conflict, Output, Record};

/// Returns the conflict between two results of one key, or `None` if they are equal.
pub(crate) fn between(kept: Record, refused: Record) -> Option<Conflict> {
    (kept.outputs != refused.outputs).then_some(Conflict {
        key: kept.key,
        stage: kept.stage,
        kept: kept.outputs,
        refused: refused.outputs,
        replaced: false,
    })
}

/// Returns a conflict as a sentence, with the digests of both results.
pub fn in_words(conflict: &Conflict) -> String {
    let digests = |outputs: &BTreeMap<String, Output>| {
        let texts = outputs
            .iter()
            .map(|(name, output)| format!("{name} {}", output.digest));
        texts.collect::<Vec<_>>().join(", ")
    };
    format!(
        "stage `{}` has two results for key {}: {} is in the shared store and stays, {} is not sent",
        conflict.stage,
        conflict.key,
        digests(&conflict.kept),
        digests(&conflict.refused),
    )
}

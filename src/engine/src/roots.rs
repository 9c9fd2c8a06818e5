//! The objects that a collection must keep: the results of runs.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{Digest, Roots, Store};

use crate::{
    record::{EngineError, RunRecord, runs},
    source::RunSource,
};

/// The runs of a store that a collection may keep, and those that it gives up.
pub struct KeptRuns {
    /// Kept in any case: the pinned runs, and the latest results of every pipeline.
    pub always: Roots,
    /// Of the runs that are to be kept, the newest first: number and results.
    pub runs: Vec<(u64, Roots)>,
    /// Numbers of the runs that are given up.
    pub given_up: Vec<u64>,
}

/// Returns the needs of the last `keep_last` runs of each pipeline and of the pinned runs. A run that cannot be read is skipped with a
/// warning. It is neither kept nor removed.
///
/// # Errors
/// A store that cannot be read.
pub fn kept_runs(
    store: &Store,
    keep_last: usize,
    pinned: &BTreeSet<u64>,
    warn: impl Fn(String),
) -> Result<KeptRuns, EngineError> {
    let mut kept = KeptRuns {
        always: Roots::default(),
        runs: Vec::new(),
        given_up: Vec::new(),
    };
    let mut seen: BTreeMap<(String, RunSource), usize> = BTreeMap::new();
    for run in runs(store, warn)?.into_iter().rev() {
        let of_pipeline = seen
            .entry((run.pipeline.clone(), run.source.series()))
            .or_default();
        *of_pipeline += 1;
        // A short run (`--to`) carries the latest results of all nodes.
        if *of_pipeline == 1 || pinned.contains(&run.number) {
            kept.always.keys.extend(keys(&run));
            kept.always.blobs.extend(documents(&run));
        } else if *of_pipeline <= keep_last {
            let roots = Roots {
                keys: keys(&run).collect(),
                blobs: documents(&run).collect(),
            };
            kept.runs.push((run.number, roots));
        } else {
            kept.given_up.push(run.number);
        }
    }
    Ok(kept)
}

fn keys(run: &RunRecord) -> impl Iterator<Item = Digest> + '_ {
    let nodes = run.nodes.iter().filter_map(|node| node.key);
    nodes.chain(run.latest.values().copied())
}

fn documents(run: &RunRecord) -> impl Iterator<Item = Digest> + '_ {
    run.documents.values().map(|document| document.digest)
}

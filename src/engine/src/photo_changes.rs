//! Which photos differ between the set that made the last result of a node and the set it would read now.

use std::collections::BTreeMap;

use marf_cache::{Action, Digest, Record, SetError, Store, StoreError, manifest::LeafRef};
use marf_stage::PHOTOS;

use crate::{
    graph::Graph,
    key::{Change, action_at, changes_between, photo_path},
    listing::{Inquiry, NoProgress},
    measure_table::row_digest,
    plan::{NodePreview, PlanOptions, plan_all},
    record::{EngineError, RunRecord},
    run,
};

/// Returns every photo that was added, edited or removed since the last result of a node, by shard and id. For a source these are the
/// photos it gives, for other nodes those it reads. If these are not known yet, the answer is that of the nearest node upstream. For a
/// source that will run, the answer is the files that differ, unless they are known only after a fetch.
///
/// # Errors
/// A store that cannot be read, a name that is not in the graph, the wish to stop.
pub fn photo_changes(
    graph: &Graph,
    store: &Store,
    last: Option<&RunRecord>,
    options: &PlanOptions<'_>,
    node: &str,
) -> Result<Vec<Change>, EngineError> {
    let index = graph
        .index(node)
        .ok_or_else(|| EngineError::unknown(graph, node))?;
    let known = plan_all(graph, store, last, options)?;
    let index = nearest_known(graph, &known, index);
    let Some(record) = last_record(store, last, &graph.nodes[index].name)? else {
        return Ok(Vec::new());
    };
    let action = action_at(store, &record.key)?;
    let (Some(now), Some(before)) = (set_now(&known[index]), last_set(&record, action.as_ref())) else {
        return match (&known[index].listed, &action) {
            (Some(listed), Some(earlier)) => {
                let inquiry = Inquiry {
                    store,
                    cancel: &options.cancel,
                    progress: &NoProgress,
                    pool: &run::pool(run::threads(options.threads))?,
                };
                let stage = graph.nodes[index].bound.as_ref();
                let changes = inquiry.file_changes(stage, listed, earlier);
                changes.map_err(|error| {
                    if options.cancel.is_set() {
                        EngineError::Stopped
                    } else {
                        EngineError::BadSet(error.to_string())
                    }
                })
            }
            _ => Ok(Vec::new()),
        };
    };
    let (before, now) = (store.set(&before)?.leaves, store.set(&now)?.leaves);
    let shared: Vec<Digest> = before
        .iter()
        .filter(|leaf| now.contains(leaf))
        .map(|leaf| leaf.leaf)
        .collect();
    let photos = |leaves: &[LeafRef]| photos(store, leaves, &shared);
    Ok(changes_between(&photos(&before)?, &photos(&now)?))
}

/// Returns the nearest node whose inputs are known, from `index` on upstream.
fn nearest_known(graph: &Graph, known: &[NodePreview], mut index: usize) -> usize {
    while known[index].inputs.is_none()
        && let Some(connection) = graph.nodes[index].connections.first()
    {
        index = connection.upstream;
    }
    index
}

/// Returns the set that a node would read now, or of a source the one it gives.
fn set_now(known: &NodePreview) -> Option<Digest> {
    let read = known.inputs.as_ref()?.optional(PHOTOS);
    read.or_else(|| known.outputs.as_ref()?.get(PHOTOS)).copied()
}

fn last_record(store: &Store, last: Option<&RunRecord>, node: &str) -> Result<Option<Record>, StoreError> {
    let key = last.and_then(|run| run.latest.get(node));
    Ok(key.map(|key| store.record(key)).transpose()?.flatten())
}

/// Returns the set of photos of the last result of a node: the one it read, of a source the one it gave.
fn last_set(record: &Record, action: Option<&Action>) -> Option<Digest> {
    let read = action.and_then(|action| action.inputs.get(PHOTOS));
    let given = || record.outputs.get(PHOTOS).map(|output| &output.digest);
    read.or_else(given).copied()
}

/// Returns the digest of each row by `photos.<shard>/<id>`, without the rows of leaves that both sets have.
fn photos(
    store: &Store,
    leaves: &[LeafRef],
    shared: &[Digest],
) -> Result<BTreeMap<String, String>, SetError> {
    let mut photos = BTreeMap::new();
    for leaf in leaves.iter().filter(|leaf| !shared.contains(&leaf.leaf)) {
        for row in store.leaf(&leaf.leaf)?.rows {
            photos.insert(photo_path(leaf.shard, &row.id), row_digest(&row).to_string());
        }
    }
    Ok(photos)
}

//! Which photos differ between the set that made the last result of a node and the set it would read now.

use std::{collections::BTreeMap, num::NonZero, sync::Arc};

use marf_cache::{
    Digest, Store, StoreError,
    manifest::{Leaf, LeafRef, ManifestError, Root},
};
use marf_stage::PHOTOS;

use crate::{
    graph::Graph,
    key::{Change, action_of, changes_between},
    measure_table::row_digest,
    plan::{Known, plan_all},
    record::{EngineError, RunRecord},
};

/// Returns every photo that was added, edited or removed since the last result of a node, by shard and id. Of a source these
/// are the photos it gives, of other nodes those it reads.
///
/// # Errors
/// A store that cannot be read, a name that is not in the graph.
pub fn photo_changes(
    graph: &Graph,
    store: &Store,
    last: Option<&RunRecord>,
    threads: Option<NonZero<usize>>,
    node: &str,
) -> Result<Vec<Change>, EngineError> {
    let index = graph
        .index(node)
        .ok_or_else(|| EngineError::unknown(graph, node))?;
    let Some((node, now)) = set_now(graph, &plan_all(graph, store, last, threads)?, index) else {
        return Ok(Vec::new());
    };
    let Some(before) = last_set(store, last, node)? else {
        return Ok(Vec::new());
    };
    let (before, now) = (read_set(store, &before)?, read_set(store, &now)?);
    let shared: Vec<Digest> = before
        .iter()
        .filter(|leaf| now.contains(leaf))
        .map(|leaf| leaf.leaf)
        .collect();
    let photos = |leaves: &[LeafRef]| photos(store, leaves, &shared);
    Ok(changes_between(&photos(&before)?, &photos(&now)?))
}

/// Returns the set that a node would read now, or of a source the one it gives. Where what it reads is not known yet, the
/// answer is of the nearest node upstream; its name comes first.
fn set_now<'a>(graph: &'a Graph, known: &[Known], mut index: usize) -> Option<(&'a str, Digest)> {
    loop {
        let node = &graph.nodes[index];
        if let Some(inputs) = &known[index].inputs {
            let outputs = || known[index].outputs.as_ref()?.get(PHOTOS);
            let set = inputs.optional(PHOTOS).or_else(outputs)?;
            return Some((&node.name, *set));
        }
        index = node.connections.first()?.upstream;
    }
}

/// Returns the set of photos of the last result of a node: the one it read, of a source the one it gave.
fn last_set(store: &Store, last: Option<&RunRecord>, node: &str) -> Result<Option<Digest>, StoreError> {
    let key = last.and_then(|run| run.latest.get(node));
    let Some(record) = key.map(|key| store.record(key)).transpose()?.flatten() else {
        return Ok(None);
    };
    let input = action_of(store, &record)?.and_then(|action| action.inputs.get(PHOTOS).copied());
    Ok(input.or_else(|| record.outputs.get(PHOTOS).map(|output| output.digest)))
}

/// Why a set cannot be read.
enum Fault {
    Store(StoreError),
    Manifest(ManifestError),
}

impl From<ManifestError> for Fault {
    fn from(error: ManifestError) -> Self {
        Self::Manifest(error)
    }
}

impl From<Fault> for EngineError {
    fn from(fault: Fault) -> Self {
        match fault {
            Fault::Store(error) => Self::Store(error),
            Fault::Manifest(error) => Self::BadSet(error.to_string()),
        }
    }
}

fn get(store: &Store, digest: &Digest) -> Result<Arc<[u8]>, Fault> {
    store.get(digest).map_err(Fault::Store)
}

fn read_set(store: &Store, root: &Digest) -> Result<Vec<LeafRef>, Fault> {
    Ok(Root::read(root, |digest| get(store, digest))?.leaves)
}

/// Returns the digest of each row by `photos.<shard>/<id>`, without the rows of leaves that both sets have.
fn photos(store: &Store, leaves: &[LeafRef], shared: &[Digest]) -> Result<BTreeMap<String, String>, Fault> {
    let mut photos = BTreeMap::new();
    for leaf in leaves.iter().filter(|leaf| !shared.contains(&leaf.leaf)) {
        for row in Leaf::decode(&get(store, &leaf.leaf)?)?.rows {
            let path = format!("photos.{:05}/{}", leaf.shard, row.id);
            photos.insert(path, row_digest(&row).to_string());
        }
    }
    Ok(photos)
}

//! Lookup of keys in the store, and the reason of a miss.

use std::collections::BTreeMap;

use marf_cache::{
    Digest, Output, Record, Store, StoreError,
    manifest::{Leaf, Root},
};
use marf_stage::{Outputs, PHOTOS};

use crate::{
    key::{Change, Key, differences},
    record::{NodeState, RunRecord},
};

/// What the store has for a key.
pub(crate) enum Lookup {
    /// A record whose outputs are all in the store.
    Hit(Box<Record>),
    /// A record whose output of this name is missing or damaged.
    MissingOutput(String),
    /// No record.
    Miss,
}

/// Looks a key up. A set of items must also have its leaves in the store.
pub(crate) fn look_up(store: &Store, key: &Digest) -> Result<Lookup, StoreError> {
    let Some(record) = store.record(key)? else {
        return Ok(Lookup::Miss);
    };
    for (name, output) in &record.outputs {
        let is_present =
            store.contains(&output.digest) && (name != PHOTOS || has_leaves(store, &output.digest)?);
        if !is_present {
            return Ok(Lookup::MissingOutput(name.clone()));
        }
    }
    Ok(Lookup::Hit(Box::new(record)))
}

fn has_leaves(store: &Store, root: &Digest) -> Result<bool, StoreError> {
    let bytes = match store.get(root) {
        Err(error) if error.lost().is_some() => return Ok(false),
        other => other?,
    };
    // A stage may name something else `photos`; that has no leaves.
    let leaves = Root::decode(&bytes).unwrap_or_default().leaves;
    Ok(leaves.iter().all(|leaf| store.contains(&leaf.leaf)))
}

/// Returns the digests of a record's outputs.
pub(crate) fn outputs_of(record: &Record) -> Outputs {
    let outputs = record.outputs.iter();
    outputs
        .map(|(name, output)| (name.clone(), output.digest))
        .collect()
}

/// Returns the figures that a stored result shows.
pub(crate) fn counts_of(store: &Store, record: &Record) -> BTreeMap<String, u64> {
    let mut counts = BTreeMap::new();
    let root = record
        .outputs
        .get(PHOTOS)
        .and_then(|output| store.get(&output.digest).ok());
    if let Some(root) = root.and_then(|bytes| Root::decode(&bytes).ok()) {
        counts.insert("photos".to_owned(), root.rows());
    }
    if !record.children.is_empty() {
        counts.insert("children".to_owned(), record.children.len() as u64);
    }
    counts
}

/// Why a node must run.
pub(crate) struct RunReason {
    pub(crate) reason: String,
    pub(crate) changes: Vec<Change>,
}

/// Explains a miss by the differences from the last key of the same node.
pub(crate) fn why_missed(
    store: &Store,
    last: Option<&RunRecord>,
    node: &str,
    key: &Key,
    lookup: &Lookup,
) -> Result<RunReason, StoreError> {
    if let Lookup::MissingOutput(output) = lookup {
        return Ok(because(format!("its stored output `{output}` is missing")));
    }
    let Some(old) = last.and_then(|run| run.latest.get(node)) else {
        return Ok(because(never_finished(last, node)));
    };
    let Some(record) = store.record(old)? else {
        return Ok(because("its record is gone".to_owned()));
    };
    let changes = differences(&record.manifest, &key.manifest);
    let reason = changes
        .first()
        .map_or_else(|| "its record is gone".to_owned(), ToString::to_string);
    Ok(RunReason { reason, changes })
}

/// Returns the reason of a node that never finished.
fn never_finished(last: Option<&RunRecord>, node: &str) -> String {
    let state = last.and_then(|run| run.node(node)).map(|node| node.state);
    let reason = match state {
        Some(NodeState::Failed) => "it failed in the last run",
        Some(NodeState::Cancelled) => "the last run was stopped",
        _ => "never ran",
    };
    reason.to_owned()
}

/// Returns a reason without differences.
pub(crate) fn because(reason: String) -> RunReason {
    RunReason {
        reason,
        changes: Vec::new(),
    }
}

/// Tells whether all outputs are in the store, with every blob that a set of items names.
pub(crate) fn is_complete(store: &Store, outputs: &BTreeMap<String, Output>) -> bool {
    outputs.iter().all(|(name, output)| {
        store.contains(&output.digest)
            && (name != PHOTOS || set_is_complete(store, &output.digest).unwrap_or(false))
    })
}

/// Tells the same of a set; none if a part of it cannot be read.
fn set_is_complete(store: &Store, root: &Digest) -> Option<bool> {
    let root = Root::decode(&store.get(root).ok()?).ok()?;
    for leaf in root.leaves {
        let leaf = Leaf::decode(&store.get(&leaf.leaf).ok()?).ok()?;
        let mut blobs = leaf.rows.iter().flat_map(|row| row.blobs.values());
        if !blobs.all(|blob| store.contains(blob)) {
            return Some(false);
        }
    }
    Some(true)
}

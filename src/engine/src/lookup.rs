//! Looks a key up, and tells why it was not found.

use std::collections::BTreeMap;

use marf_cache::{
    Digest, Output, Record, Store, StoreError,
    manifest::{Leaf, Root},
};
use marf_stage::{Outputs, PHOTOS};

use crate::{
    Change, NodeState, RunRecord,
    key::{Key, differences},
};

/// What the store has for a key.
pub(crate) enum Found {
    /// A record whose outputs are all here.
    Hit(Box<Record>),
    /// A record whose output of this name is not here, or is damaged.
    Lost(String),
    /// No record.
    Nothing,
}

/// Looks a key up; a set of items must have its leaves too.
pub(crate) fn look_up(store: &Store, key: &Digest) -> Result<Found, StoreError> {
    let Some(record) = store.record(key)? else {
        return Ok(Found::Nothing);
    };
    for (name, output) in &record.outputs {
        let whole = store.contains(&output.digest) && (name != PHOTOS || leaves_live(store, &output.digest)?);
        if !whole {
            return Ok(Found::Lost(name.clone()));
        }
    }
    Ok(Found::Hit(Box::new(record)))
}

fn leaves_live(store: &Store, root: &Digest) -> Result<bool, StoreError> {
    let bytes = match store.get(root) {
        Err(error) if error.lost().is_some() => return Ok(false),
        other => other?,
    };
    // A stage may call something else `photos`; then there are no leaves to look for.
    let leaves = Root::decode(&bytes).unwrap_or_default().leaves;
    Ok(leaves.iter().all(|leaf| store.contains(&leaf.leaf)))
}

pub(crate) fn outputs_of(record: &Record) -> Outputs {
    let outputs = record.outputs.iter();
    outputs
        .map(|(name, output)| (name.clone(), output.digest))
        .collect()
}

/// Returns the figures that can be read off the outputs of a node that did not run.
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
pub(crate) struct Why {
    pub(crate) reason: String,
    pub(crate) changes: Vec<Change>,
}

/// Compares a key that was not found with the last one of the same node.
pub(crate) fn why_missed(
    store: &Store,
    last: Option<&RunRecord>,
    node: &str,
    key: &Key,
    found: &Found,
) -> Result<Why, StoreError> {
    if let Found::Lost(output) = found {
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
    Ok(Why { reason, changes })
}

fn never_finished(last: Option<&RunRecord>, node: &str) -> String {
    let state = last.and_then(|run| run.node(node)).map(|node| node.state);
    let reason = match state {
        Some(NodeState::Failed) => "it failed in the last run",
        Some(NodeState::Cancelled) => "the last run was stopped",
        _ => "never ran",
    };
    reason.to_owned()
}

pub(crate) fn because(reason: String) -> Why {
    Why {
        reason,
        changes: Vec::new(),
    }
}

/// Tells whether outputs are here down to the last blob that a set of items names.
pub(crate) fn is_whole(store: &Store, outputs: &BTreeMap<String, Output>) -> bool {
    outputs.iter().all(|(name, output)| {
        store.contains(&output.digest)
            && (name != PHOTOS || set_is_whole(store, &output.digest).unwrap_or(false))
    })
}

/// None if a part of the set cannot be read.
fn set_is_whole(store: &Store, root: &Digest) -> Option<bool> {
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

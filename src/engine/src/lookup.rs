//! Lookup of keys in the store, and the reason of a miss.

use std::collections::BTreeMap;

use marf_cache::{Digest, LISTING, Record, Store, StoreError};
use marf_stage::Outputs;

use crate::{
    key::{Change, Key, action_at, differences},
    listing::SourceListing,
    record::{NodeState, RunRecord},
};

/// The result of looking up a key in the store.
pub(crate) enum Lookup {
    /// A record whose outputs are all in the store.
    Hit(Box<Record>),
    /// A record whose output of this name is missing or damaged.
    MissingOutput(String),
    /// No record.
    Miss,
}

/// Looks a key up. What its outputs name is not looked for: a lost leaf or photo is made again by the run that reads it.
pub(crate) fn look_up(store: &Store, key: &Digest) -> Result<Lookup, StoreError> {
    let Some(record) = store.record(key)? else {
        return Ok(Lookup::Miss);
    };
    let is_missing = |output: &marf_cache::Output| !store.contains(&output.digest);
    let missing = record.outputs.iter().find(|(_, output)| is_missing(output));
    match missing.map(|(name, _)| name.clone()) {
        Some(name) => Ok(Lookup::MissingOutput(name)),
        // `hit` protects the result from a collection that runs at this moment.
        None => Ok(store
            .hit(key)?
            .map_or(Lookup::Miss, |record| Lookup::Hit(Box::new(record)))),
    }
}

/// Returns the digests of a record's outputs.
pub(crate) fn outputs_of(record: &Record) -> Outputs {
    let outputs = record.outputs.iter();
    outputs
        .map(|(name, output)| (name.clone(), output.digest))
        .collect()
}

/// Returns the figures of a stored result that hold for it whoever made it: not what was measured or fetched then.
pub(crate) fn lasting_counts(record: &Record) -> BTreeMap<String, u64> {
    const LASTING: [&str; 4] = ["children", "photos", "rejected", "shards"];
    let counts = record.metadata.counts.iter();
    counts
        .filter(|(name, _)| LASTING.contains(&name.as_str()))
        .map(|(name, count)| (name.clone(), *count))
        .collect()
}

/// Why a node must run.
pub(crate) struct RunReason {
    pub(crate) reason: String,
    pub(crate) changes: Vec<Change>,
}

/// Returns the reason of a node whose record names an output that is not in the store.
pub(crate) fn lost_output(output: &str) -> RunReason {
    because(format!("its stored output `{output}` is missing"))
}

/// Explains a miss by the differences from the last key of the same node.
pub(crate) fn why_missed(
    store: &Store,
    last: Option<&RunRecord>,
    node: &str,
    key: &Key,
    listed: Option<&SourceListing>,
) -> Result<RunReason, StoreError> {
    let Some(old) = last.and_then(|run| run.latest.get(node)) else {
        return Ok(because(never_finished(last, node)));
    };
    let Some(record) = store.record(old)? else {
        return Ok(because("its record is gone".to_owned()));
    };
    let Some(earlier) = action_at(store, &record.key)? else {
        return Ok(because("its record is damaged".to_owned()));
    };
    let mut changes = differences(&earlier, &key.action);
    // The shards that changed say more than that the listing did.
    let of_listing = format!("inputs.{LISTING}");
    if let Some(at) = changes.iter().position(|change| change.path == of_listing)
        && let Some(shards) = listed.and_then(|listed| listed.changes_since(store, &earlier))
    {
        changes.splice(at..=at, shards);
    }
    let place = listed.and_then(|listed| listed.listing.place.as_ref());
    let reason = match (changes.first(), place) {
        (None, _) => "its record is gone".to_owned(),
        (Some(change), Some(place)) if change.shard().is_some() => format!("{place}: {change}"),
        (Some(change), _) => change.to_string(),
    };
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

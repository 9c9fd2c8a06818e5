//! How much a node would look at if it ran now, from the keys of its parts.

use marf_cache::{Record, Store, StoreError};
use marf_stage::{Inputs, Map, PHOTOS, Stage, Work};
use serde::Serialize;

use super::{
    compare::{Context, part_inputs, summary_of},
    fold,
    source::fetch_inputs,
    stage_run::{ADDED, PartKind, part_key},
};
use crate::{
    errors::store_error,
    items::{ShardLeaves, by_shard},
    key::Key,
    listing::SourceListing,
};

/// How much a node would look at.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Extent {
    /// Shards (sols) without a result.
    pub shards: u64,
    /// Photos of these shards. None if they are not fetched yet.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photos: Option<u64>,
}

/// Returns the shards and photos that a node would look at. None if it does not work on a set of photos, or its inputs cannot be read.
pub(crate) fn extent(
    store: &Store,
    stage: &dyn Stage,
    key: &Key,
    inputs: &Inputs,
    listed: Option<&SourceListing>,
) -> Result<Option<Extent>, StoreError> {
    if let Some(listed) = listed {
        return of_source(store, key, listed).map(Some);
    }
    let Some(set) = inputs.optional(PHOTOS).and_then(|root| store.set(root).ok()) else {
        return Ok(None);
    };
    let shards = by_shard(&set);
    let missing: Vec<&ShardLeaves> = match stage.work() {
        Work::Map(map) => missing_parts(store, map, key, &shards)?,
        Work::Fold(_) => missing_steps(store, key, &shards)?,
        _ => shards.iter().collect(),
    };
    Ok(Some(Extent {
        shards: missing.len() as u64,
        photos: Some(missing.iter().map(|shard| shard.rows()).sum()),
    }))
}

fn of_source(store: &Store, key: &Key, listed: &SourceListing) -> Result<Extent, StoreError> {
    let mut missing = 0;
    for shard in &listed.listing.shards {
        let part = part_key(&key.action, PartKind::Fetch, shard.shard, fetch_inputs(shard));
        missing += u64::from(store.hit(&part.digest)?.is_none());
    }
    Ok(Extent {
        shards: missing,
        photos: None,
    })
}

/// Returns the shards of a map without a summary, if there are any, else those without a decision. Only after the new summaries are made is
/// it known whether they change the decisions on other shards.
fn missing_parts<'a>(
    store: &Store,
    map: &dyn Map,
    key: &Key,
    shards: &'a [ShardLeaves],
) -> Result<Vec<&'a ShardLeaves>, StoreError> {
    let mut context = Context::default();
    if let Some(comparison) = map.comparison() {
        for (index, name) in comparison.passes().into_iter().enumerate() {
            let found = find(store, key, PartKind::Summarise(name), shards, &context)?;
            let summaries: Vec<_> = found
                .iter()
                .map(|record| record.as_ref().and_then(summary_of))
                .collect();
            let missing = lacking(shards, &summaries);
            if !missing.is_empty() {
                return Ok(missing);
            }
            let summaries = summaries.iter().flatten();
            let mut summaries = summaries.map(|summary| store.get(summary).map_err(store_error));
            match comparison.context(index, &context.bytes, &mut summaries) {
                Ok(bytes) => context = Context::new(bytes),
                // The run makes again what cannot be read, and then all may be decided again.
                Err(_) => return Ok(shards.iter().collect()),
            }
        }
    }
    let decisions = find(store, key, PartKind::Decide, shards, &context)?;
    Ok(lacking(shards, &decisions))
}

/// Returns the record of the part of each shard that looks at a context.
fn find(
    store: &Store,
    key: &Key,
    part: PartKind,
    shards: &[ShardLeaves],
    context: &Context,
) -> Result<Vec<Option<Record>>, StoreError> {
    let find = |shard: &ShardLeaves| {
        let part = part_key(&key.action, part, shard.shard, part_inputs(shard, context));
        store.hit(&part.digest)
    };
    shards.iter().map(find).collect()
}

/// Returns the shards without an entry in `found`.
fn lacking<'a, T>(shards: &'a [ShardLeaves], found: &[Option<T>]) -> Vec<&'a ShardLeaves> {
    let pairs = shards.iter().zip(found);
    pairs
        .filter(|(_, found)| found.is_none())
        .map(|(shard, _)| shard)
        .collect()
}

/// Returns the shards from the first step without a record on.
fn missing_steps<'a>(
    store: &Store,
    key: &Key,
    shards: &'a [ShardLeaves],
) -> Result<Vec<&'a ShardLeaves>, StoreError> {
    let mut before = fold::start();
    for (index, shard) in shards.iter().enumerate() {
        let inputs = fold::step_inputs(shard, before);
        let part = part_key(&key.action, PartKind::Fold, shard.shard, inputs);
        let record = store.hit(&part.digest)?;
        match record.and_then(|record| Some(record.outputs.get(ADDED)?.digest)) {
            Some(added) => before = fold::after(&before, &added),
            None => return Ok(shards[index..].iter().collect()),
        }
    }
    Ok(Vec::new())
}

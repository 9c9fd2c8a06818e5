//! How much a node would look at if it ran now, from the keys of its parts.

use marf_cache::{Store, StoreError};
use marf_stage::{Inputs, PHOTOS, Scope, Stage, Work};
use serde::Serialize;

use super::{
    fold,
    map::leaf_inputs,
    source::fetch_inputs,
    stage_run::{ADDED, PartKind, part_key},
};
use crate::{
    items::{ShardLeaves, by_shard, rows_of},
    key::Key,
    listing::Listed,
};

/// How much a node would look at.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Extent {
    /// Shards (sols) without a result.
    pub shards: u64,
    /// Photos of these shards; none where they are not fetched yet.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photos: Option<u64>,
}

/// Returns what a node would look at; none if it works on no set of photos, or its inputs cannot be read.
pub(crate) fn extent(
    store: &Store,
    stage: &dyn Stage,
    key: &Key,
    inputs: &Inputs,
    listed: Option<&Listed>,
) -> Result<Option<Extent>, StoreError> {
    if let Some(listed) = listed {
        return of_source(store, key, listed).map(Some);
    }
    let Some(set) = inputs.optional(PHOTOS).and_then(|root| store.set(root).ok()) else {
        return Ok(None);
    };
    let shards = by_shard(&set);
    let missing: Vec<&ShardLeaves> = match stage.work() {
        Work::Map(map) if map.scope() == Scope::Item => missing_decisions(store, key, &shards)?,
        Work::Fold(_) => missing_steps(store, key, &shards)?,
        _ => shards.iter().collect(),
    };
    Ok(Some(Extent {
        shards: missing.len() as u64,
        photos: Some(missing.iter().map(|shard| rows_of(&shard.1)).sum()),
    }))
}

fn of_source(store: &Store, key: &Key, listed: &Listed) -> Result<Extent, StoreError> {
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

fn missing_decisions<'a>(
    store: &Store,
    key: &Key,
    shards: &'a [ShardLeaves],
) -> Result<Vec<&'a ShardLeaves>, StoreError> {
    let mut missing = Vec::new();
    for shard in shards {
        let part = part_key(&key.action, PartKind::Decide, shard.0, leaf_inputs(shard));
        missing.extend(store.hit(&part.digest)?.is_none().then_some(shard));
    }
    Ok(missing)
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
        let part = part_key(&key.action, PartKind::Fold, shard.0, inputs);
        let record = store.hit(&part.digest)?;
        match record.and_then(|record| Some(record.outputs.get(ADDED)?.digest)) {
            Some(added) => before = fold::after(&before, &added),
            None => return Ok(shards[index..].iter().collect()),
        }
    }
    Ok(Vec::new())
}

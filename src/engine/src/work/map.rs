//! Maps: a measure for each row, then a decision on the rows of a shard, or on those of the whole set.

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_stage::{Ctx, Map, Measured, PHOTOS, Scope, StageError, Verdict};
use rayon::prelude::*;

use super::{
    measure::{MeasuredShard, measure, windows},
    stage_run::{Counts, Part, PartKind, PartedOutputs, StageRun},
};
use crate::{
    errors::contract_violation,
    items::{ShardLeaves, ShardRows, by_shard, kept, read_set, rows_of, write_shard, write_verdicts},
    key::Key,
    stage_io::StoreBlobs,
};

/// Decides the rows of all shards, and keeps those that the decision keeps.
pub(super) fn execute(run: &StageRun<'_>, map: &dyn Map) -> Result<PartedOutputs, StageError> {
    let shards = by_shard(&read_set(&run.ctx, run.inputs.required(PHOTOS)?)?);
    match map.scope() {
        Scope::Item => by_item(run, map, &shards),
        Scope::Set => as_set(run, map, &shards),
    }
}

/// Returns the inputs of a part that reads the leaves of a shard.
pub(super) fn leaf_inputs((_, leaves): &ShardLeaves) -> BTreeMap<String, Digest> {
    let named = |(index, leaf): (usize, &marf_cache::manifest::LeafRef)| (format!("rows.{index}"), leaf.leaf);
    leaves.iter().enumerate().map(named).collect()
}

/// Decides shard by shard; each decision has its record, so a new shard decides its own rows alone.
fn by_item(run: &StageRun<'_>, map: &dyn Map, shards: &[ShardLeaves]) -> Result<PartedOutputs, StageError> {
    let keys: Vec<Key> = shards
        .par_iter()
        .map(|shard| run.part_key(PartKind::Decide, shard.0, leaf_inputs(shard)))
        .collect();
    let mut parts: Vec<Option<Part>> = Vec::with_capacity(shards.len());
    for key in &keys {
        run.ctx.check()?;
        parts.push(run.part_hit(&key.digest)?);
    }
    let missing: Vec<usize> = (0..shards.len()).filter(|&at| parts[at].is_none()).collect();
    let total: u64 = missing.iter().map(|&at| rows_of(&shards[at].1)).sum();
    let (mut done, mut measured) = (0, 0);
    for window in windows(&missing, |&at| rows_of(&shards[at].1)) {
        let leaves: Vec<&ShardLeaves> = window.iter().map(|&at| &shards[at]).collect();
        let read = measure(run, map, &leaves, (done, total))?;
        measured += read.measured;
        done += read.rows();
        let decided: Result<Vec<Part>, StageError> = window
            .par_iter()
            .zip(read.shards)
            .map(|(&at, shard)| {
                let verdicts = map.decide(&shard.items())?;
                decided(run, &keys[at], shard, verdicts)
            })
            .collect();
        for (&at, part) in window.iter().zip(decided?) {
            parts[at] = Some(part);
        }
    }
    let counts = Counts::from([
        ("measured".to_owned(), measured),
        ("decided".to_owned(), missing.len() as u64),
    ]);
    let keys = shards.iter().zip(keys).map(|(shard, key)| (shard.0, key.digest));
    run.join(keys.collect(), parts.into_iter().flatten().collect(), counts)
}

/// Stores the verdicts on a shard and the rows they keep, as a part.
fn decided(
    run: &StageRun<'_>,
    key: &Key,
    shard: MeasuredShard,
    verdicts: Vec<Verdict>,
) -> Result<Part, StageError> {
    let blobs = StoreBlobs::new(run.store);
    let part = store_decided(&run.with_blobs(&blobs), shard.rows, verdicts)?;
    run.put_part(key, &part, &blobs)?;
    Ok(part)
}

/// Stores the verdicts on a shard and the rows they keep.
pub(super) fn store_decided(
    ctx: &Ctx<'_>,
    rows: ShardRows,
    verdicts: Vec<Verdict>,
) -> Result<Part, StageError> {
    let shard = rows.shard;
    let rows = kept(rows.rows, &verdicts)?;
    Ok(Part {
        photos: write_shard(ctx, ShardRows { shard, rows })?,
        verdicts: write_verdicts(ctx, shard, verdicts)?,
        added: None,
    })
}

/// Decides on all rows at once.
fn as_set(run: &StageRun<'_>, map: &dyn Map, shards: &[ShardLeaves]) -> Result<PartedOutputs, StageError> {
    let all: Vec<usize> = (0..shards.len()).collect();
    let total: u64 = shards.iter().map(|shard| rows_of(&shard.1)).sum();
    let (mut read, mut measured, mut done) = (Vec::new(), 0, 0);
    for window in windows(&all, |&at| rows_of(&shards[at].1)) {
        let leaves: Vec<&ShardLeaves> = window.iter().map(|&at| &shards[at]).collect();
        let part = measure(run, map, &leaves, (done, total))?;
        measured += part.measured;
        done += part.rows();
        read.extend(part.shards);
    }
    let items: Vec<Measured<'_>> = read.iter().flat_map(MeasuredShard::items).collect();
    let verdicts = map.decide(&items)?;
    if verdicts.len() != items.len() {
        let (got, wanted) = (verdicts.len(), items.len());
        return Err(contract_violation(format!(
            "{got} verdicts came for {wanted} photos"
        )));
    }
    drop(items);
    let mut verdicts = verdicts.into_iter();
    let mut whole = Part::default();
    for shard in read {
        let own = verdicts.by_ref().take(shard.rows.rows.len()).collect();
        let part = store_decided(&run.ctx, shard.rows, own)?;
        whole.photos.extend(part.photos);
        whole.verdicts.extend(part.verdicts);
    }
    let counts = Counts::from([
        ("measured".to_owned(), measured),
        ("decided".to_owned(), shards.len() as u64),
    ]);
    run.join(Vec::new(), whole, counts)
}

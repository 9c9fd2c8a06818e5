//! Maps: a measure for each row, then a decision on the rows of each shard, which uses these rows and the merged summaries of all shards.

use marf_stage::{Ctx, Map, PHOTOS, StageError, Verdict};
use rayon::prelude::*;

use super::{
    compare::{ComparisonResult, compare, part_inputs},
    measure::MeasuredShard,
    shards::{PartRequest, shard_parts},
    stage_run::{Counts, Part, PartKind, PartedOutputs, StageRun},
};
use crate::{
    items::{ShardLeaves, ShardRows, by_shard, kept, read_set, write_shard, write_verdicts},
    key::Key,
    stage_io::StoreBlobs,
};

/// Decides the rows of all shards, and keeps those that the decision keeps. Each decision has its record, so a new shard
/// decides its own rows alone unless it changes what rows are compared with.
pub(super) fn execute(run: &StageRun<'_>, map: &dyn Map) -> Result<PartedOutputs, StageError> {
    let shards = by_shard(&read_set(&run.ctx, run.inputs.required(PHOTOS)?)?);
    let compared = match map.comparison() {
        Some(comparison) => compare(run, map, comparison, &shards)?,
        None => ComparisonResult::default(),
    };
    let context = &compared.context;
    let key = |shard: &ShardLeaves| run.part_key(PartKind::Decide, shard.shard, part_inputs(shard, context));
    let requests: Vec<PartRequest<'_>> = shards
        .par_iter()
        .map(|shard| PartRequest::new(shard, key(shard)))
        .collect();
    let decisions = shard_parts(
        run,
        map,
        &requests,
        |key| run.part_hit(key),
        |key, shard| {
            let verdicts = map.decide(&context.bytes, &shard.items())?;
            store_part(run, key, shard, verdicts)
        },
    )?;
    let mut counts = Counts::from([
        ("measured".to_owned(), compared.measured + decisions.measured),
        ("decided".to_owned(), decisions.made),
    ]);
    if map.comparison().is_some() {
        counts.insert("summarised".to_owned(), compared.summarised);
    }
    let mut keys = compared.keys;
    keys.extend(requests.iter().map(PartRequest::shard_key));
    keys.sort_by_key(|(shard, _)| *shard);
    run.join(keys, decisions.parts.into_iter().collect(), counts)
}

/// Stores the verdicts on a shard and the rows they keep, as a part.
fn store_part(
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

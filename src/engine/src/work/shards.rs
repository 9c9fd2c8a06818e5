//! Parts of a node by shard: those that have a record are taken, the others are made, some shards at a time.

use marf_cache::Digest;
use marf_stage::{Measure, StageError};
use rayon::prelude::*;

use super::{
    elsewhere::measure_elsewhere,
    measure::{MeasuredShard, measure, windows},
    stage_run::StageRun,
};
use crate::{
    errors::store_error,
    items::{ShardLeaves, rows_of},
    key::Key,
};

/// One part of each shard, in the order of the shards.
pub(super) struct ShardParts<P> {
    pub(super) keys: Vec<Key>,
    pub(super) parts: Vec<P>,
    /// How many of them had no record.
    pub(super) made: u64,
    /// Number of rows that no earlier run had measured.
    pub(super) measured: u64,
}

/// Returns a part of each shard: what `find` returns for its key, else what `make` makes of its rows and measures. The rows of
/// one window of shards are in memory at once.
pub(super) fn shard_parts<P: Send>(
    run: &StageRun<'_>,
    stage: &dyn Measure,
    shards: &[ShardLeaves],
    key: impl Fn(&ShardLeaves) -> Key + Sync,
    find: impl Fn(&Digest) -> Result<Option<P>, StageError>,
    make: impl Fn(&Key, MeasuredShard) -> Result<P, StageError> + Sync,
) -> Result<ShardParts<P>, StageError> {
    let keys: Vec<Key> = shards.par_iter().map(&key).collect();
    run.fetch_parts(keys.iter().map(|key| key.digest))?;
    let mut parts: Vec<Option<P>> = Vec::with_capacity(shards.len());
    for key in &keys {
        run.ctx.check()?;
        parts.push(find(&key.digest)?);
    }
    let missing: Vec<usize> = (0..shards.len()).filter(|&at| parts[at].is_none()).collect();
    let lacking: Vec<&ShardLeaves> = missing.iter().map(|&at| &shards[at]).collect();
    let mut measured = measure_elsewhere(run, stage, &lacking)?;
    let total: u64 = missing.iter().map(|&at| rows_of(&shards[at].1)).sum();
    let mut done = 0;
    for window in windows(&missing, |&at| rows_of(&shards[at].1)) {
        run.ctx.check()?;
        let leaves: Vec<&ShardLeaves> = window.iter().map(|&at| &shards[at]).collect();
        let read = measure(run, stage, &leaves, done, total)?;
        measured += read.measured;
        done += read.rows();
        let made: Result<Vec<P>, StageError> = window
            .par_iter()
            .zip(read.shards)
            .map(|(&at, shard)| make(&keys[at], shard))
            .collect();
        for (&at, part) in window.iter().zip(made?) {
            parts[at] = Some(part);
        }
        if done < total {
            // What is stored is in memory until then.
            run.store.commit().map_err(store_error)?;
        }
    }
    Ok(ShardParts {
        keys,
        parts: parts.into_iter().flatten().collect(),
        made: missing.len() as u64,
        measured,
    })
}

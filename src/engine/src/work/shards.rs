//! Parts of a node by shard: those that have a record are taken, the others are made, some shards at a time.

use marf_cache::Digest;
use marf_stage::{Measure, StageError};
use rayon::prelude::*;

use super::{
    measure::{MeasuredShard, RowProgress, measure, windows},
    stage_run::StageRun,
};
use crate::{errors::store_error, items::ShardLeaves, key::Key};

/// A part of a node that is about one shard, by its key.
pub(super) struct PartRequest<'a> {
    pub(super) shard: &'a ShardLeaves,
    pub(super) key: Key,
}

impl<'a> PartRequest<'a> {
    pub(super) fn new(shard: &'a ShardLeaves, key: Key) -> Self {
        Self { shard, key }
    }

    /// Returns the number of the shard with the key.
    pub(super) fn shard_key(&self) -> (u32, Digest) {
        (self.shard.shard, self.key.digest)
    }
}

/// The parts that were requested, in the order of the requests.
pub(super) struct ShardParts<P> {
    pub(super) parts: Vec<P>,
    /// How many of them had no record.
    pub(super) made: u64,
    /// Number of rows that no earlier run had measured.
    pub(super) measured: u64,
}

/// Returns the requested parts: what `find` returns for a key, else what `make` makes of the rows and measures of the shard. The
/// rows of one window of shards are in memory at once.
pub(super) fn shard_parts<P: Send>(
    run: &StageRun<'_>,
    stage: &dyn Measure,
    requests: &[PartRequest<'_>],
    find: impl Fn(&Digest) -> Result<Option<P>, StageError>,
    make: impl Fn(&Key, MeasuredShard) -> Result<P, StageError> + Sync,
) -> Result<ShardParts<P>, StageError> {
    run.fetch_parts(requests.iter().map(|request| request.key.digest))?;
    let mut parts: Vec<Option<P>> = Vec::with_capacity(requests.len());
    for request in requests {
        run.ctx.check()?;
        parts.push(find(&request.key.digest)?);
    }
    let missing: Vec<usize> = (0..requests.len()).filter(|&at| parts[at].is_none()).collect();
    let mut measured = 0;
    let total: u64 = missing.iter().map(|&at| requests[at].shard.rows()).sum();
    let mut progress = RowProgress::new(run, total);
    for window in windows(&missing, |&at| requests[at].shard.rows()) {
        run.ctx.check()?;
        let leaves: Vec<&ShardLeaves> = window.iter().map(|&at| requests[at].shard).collect();
        let read = measure(run, stage, &leaves, &mut progress)?;
        measured += read.measured;
        let made: Result<Vec<P>, StageError> = window
            .par_iter()
            .zip(read.shards)
            .map(|(&at, shard)| make(&requests[at].key, shard))
            .collect();
        for (&at, part) in window.iter().zip(made?) {
            parts[at] = Some(part);
        }
        if !progress.is_complete() {
            // What is stored is in memory until then.
            run.store.commit().map_err(store_error)?;
        }
    }
    Ok(ShardParts {
        parts: parts.into_iter().flatten().collect(),
        made: missing.len() as u64,
        measured,
    })
}

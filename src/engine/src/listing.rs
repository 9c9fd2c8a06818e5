//! Listings of sources, made for every plan and every run.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};

use marf_cache::{Digest, Store};
use marf_stage::{Cancel, Checkpoints, Ctx, Listing, Memos, Progress, Stage, StageError, Work};

use crate::{
    errors::{contract_violation, panicked},
    stage_io::StoreBlobs,
};

/// Lists what a source offers; none for other stages.
pub(crate) fn list(
    stage: &dyn Stage,
    store: &Store,
    cancel: &Cancel,
    progress: &dyn Progress,
) -> Result<Option<Listing>, StageError> {
    let Work::Source(source) = stage.work() else {
        return Ok(None);
    };
    let ctx = Ctx {
        blobs: &StoreBlobs(store),
        cancel,
        progress,
        checkpoints: &NoState,
        memos: &NoState,
        scratch: &store.scratch(),
        threads: 1,
    };
    let listing = catch_unwind(AssertUnwindSafe(|| source.list(&ctx)))
        .unwrap_or_else(|payload| Err(panicked(payload.as_ref())))?;
    let unsorted = listing
        .shards
        .windows(2)
        .find(|pair| pair[0].shard >= pair[1].shard);
    match unsorted {
        Some(pair) => Err(contract_violation(format!(
            "shard {} is listed twice or out of order",
            pair[1].shard
        ))),
        None => Ok(Some(listing)),
    }
}

/// Checkpoints and memos of a listing: none is kept.
struct NoState;

impl Checkpoints for NoState {
    fn load(&self) -> Option<Vec<u8>> {
        None
    }

    fn save(&self, _state: &[u8]) {}
}

impl Memos for NoState {
    fn load(&self, _key: &Digest) -> Option<Arc<[u8]>> {
        None
    }

    fn save(&self, _key: &Digest, _table: &[u8]) {}
}

/// Ignores progress: of a listing that is made for a plan.
pub(crate) struct NoProgress;

impl Progress for NoProgress {
    fn at(&self, _done: u64, _total: u64, _note: &str) {}
}

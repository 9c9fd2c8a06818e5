//! Stops and saves a mapping.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use marf_sfm::Supervisor;
use marf_sfm::mapper::MapError;
use marf_stage::{Ctx, StageError};

/// The node's cancel request and checkpoints, with the time of the last one.
pub(super) struct NodeSupervisor<'a> {
    ctx: &'a Ctx<'a>,
    saved_at: Mutex<Instant>,
}

impl<'a> NodeSupervisor<'a> {
    pub(super) fn new(ctx: &'a Ctx<'a>) -> Self {
        Self {
            ctx,
            saved_at: Mutex::new(Instant::now()),
        }
    }
}

impl Supervisor for NodeSupervisor<'_> {
    fn stop(&self) -> bool {
        self.ctx.cancel.is_set()
    }

    fn unsaved_for(&self) -> Duration {
        let saved_at = self.saved_at.lock().unwrap_or_else(PoisonError::into_inner);
        saved_at.elapsed()
    }

    fn load(&self, part: &str) -> Option<Vec<u8>> {
        self.ctx.checkpoints.load(part)
    }

    fn save(&self, part: &str, state: &[u8]) {
        self.ctx.checkpoints.save(part, state);
        *self.saved_at.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
    }
}

/// Returns the error of the stage for that of a mapping.
pub(super) fn failed(error: MapError) -> StageError {
    match error {
        MapError::Stopped => StageError::Cancelled,
        other => StageError::new(other.to_string()),
    }
}

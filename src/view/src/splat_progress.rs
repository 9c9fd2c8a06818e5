//! How far splats are.

use parking_lot::Mutex;
use serde::Serialize;

/// How far splats are.
#[derive(Debug, Default)]
pub struct SplatProgress(Mutex<SplatStep>);

/// A step of making splats.
#[derive(Debug, Default, Clone, Serialize)]
pub struct SplatStep {
    done: u64,
    total: u64,
    note: String,
}

impl SplatProgress {
    /// Keeps the newest step.
    pub fn at(&self, done: u64, total: u64, note: &str) {
        let note = note.to_owned();
        *self.0.lock() = SplatStep { done, total, note };
    }

    /// Returns the newest step.
    pub(crate) fn step(&self) -> SplatStep {
        self.0.lock().clone()
    }
}

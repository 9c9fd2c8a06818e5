//! A request to stop that comes after a number of polls.

use std::sync::atomic::{AtomicU64, Ordering};

/// Counts polls and stops after a number of them.
pub(crate) struct Polls {
    count: AtomicU64,
    stop_after: u64,
}

impl Polls {
    /// Stops after so many polls.
    pub(crate) fn new(stop_after: u64) -> Self {
        Self {
            count: AtomicU64::new(0),
            stop_after,
        }
    }

    /// Whether to stop, a poll.
    pub(crate) fn stop(&self) -> bool {
        self.count.fetch_add(1, Ordering::Relaxed) >= self.stop_after
    }

    /// Returns the number of polls.
    pub(crate) fn count(&self) -> u64 {
        self.count.load(Ordering::Relaxed)
    }
}

//! Progress of the work on a shared store, and the wish to stop it.

use std::sync::atomic::{AtomicU64, Ordering};

/// How far a push or a pull is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Progress {
    /// Bytes moved.
    pub done_bytes: u64,
    /// Bytes to move, including those already moved. 0 while unknown.
    pub total_bytes: u64,
}

/// Receives progress, and can stop the work.
pub trait Observer: Sync {
    /// Receives how far the work is.
    fn on_progress(&self, progress: Progress);
    /// Returns whether the user wants to stop.
    fn is_stopped(&self) -> bool;
}

/// Whether the user wants to stop, of work whose progress nobody follows.
impl<F: Fn() -> bool + Sync> Observer for F {
    fn on_progress(&self, _progress: Progress) {}

    fn is_stopped(&self) -> bool {
        self()
    }
}

/// Adds up bytes for an observer.
pub(crate) struct Meter<'a> {
    observer: &'a dyn Observer,
    done_bytes: AtomicU64,
    pub(crate) total_bytes: u64,
}

impl<'a> Meter<'a> {
    pub(crate) fn new(observer: &'a dyn Observer, total_bytes: u64) -> Self {
        Self {
            observer,
            done_bytes: AtomicU64::new(0),
            total_bytes,
        }
    }

    pub(crate) fn add(&self, bytes: u64) {
        let done_bytes = self.done_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes;
        let total_bytes = self.total_bytes;
        self.observer.on_progress(Progress {
            done_bytes,
            total_bytes,
        });
    }
}

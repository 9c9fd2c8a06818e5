use std::path::Path;
use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};
use std::time::Instant;

use marf_cache::Digest;
use schemars::JsonSchema;
use serde::Deserialize;

use crate::error::{BlobError, StageError};

/// Resources of a running stage in addition to its parameters and inputs.
#[derive(Clone, Copy)]
pub struct Ctx<'a> {
    /// The object store.
    pub blobs: &'a dyn Blobs,
    /// Whether the run should stop.
    pub cancel: &'a Cancel,
    /// Receives progress.
    pub progress: &'a dyn Progress,
    /// Saves the state of an unfinished run under this node's key.
    pub checkpoints: &'a dyn Checkpoints,
    /// Tables of partial results that outlive this run.
    pub memos: &'a dyn Memos,
    /// A folder for files of unfinished work (half a download, the last listing of a server), created by the stage. Its
    /// files may vanish between runs and never change a result.
    pub scratch: &'a Path,
    /// Threads given to this run. A rayon pool of that size is installed. Never part of a result.
    pub threads: usize,
    /// Start of the whole run.
    pub began: Instant,
}

impl Ctx<'_> {
    /// Returns an error if the user asked to stop.
    ///
    /// # Errors
    /// [`StageError::Cancelled`].
    pub fn check(&self) -> Result<(), StageError> {
        if self.cancel.is_set() {
            Err(StageError::Cancelled)
        } else {
            Ok(())
        }
    }

    /// Does a part of the work and reports how long it took ([`Progress::took`]).
    pub fn timed<T>(&self, part: &'static str, work: impl FnOnce() -> T) -> T {
        let begun = Instant::now();
        let done = work();
        self.progress.took(part, begun.elapsed().as_secs_f64());
        done
    }

    /// Reads a blob and verifies its digest.
    ///
    /// # Errors
    /// A missing or damaged blob.
    pub fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, StageError> {
        Ok(self.blobs.get(digest)?)
    }

    /// Stores a blob and returns its digest.
    ///
    /// # Errors
    /// A store that cannot be written.
    pub fn put(&self, bytes: &[u8]) -> Result<Digest, StageError> {
        Ok(self.blobs.put(bytes)?)
    }
}

/// A store of byte strings by digest.
pub trait Blobs: Sync {
    /// Reads a blob and verifies its digest.
    ///
    /// # Errors
    /// A missing or damaged blob.
    fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, BlobError>;
    /// Stores a blob. The same bytes are stored once.
    ///
    /// # Errors
    /// Returns an error if the store cannot be written.
    fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError>;
    /// Stores a file and returns the bytes that were stored, with their digest.
    ///
    /// # Errors
    /// A file that cannot be read, is larger than `max_bytes`, or a store that cannot be written.
    fn put_file(&self, path: &Path, max_bytes: u64, keep: Keep) -> Result<(Digest, Arc<[u8]>), BlobError>;
    /// Returns whether a blob is in the store. Its bytes are not read.
    fn contains(&self, digest: &Digest) -> bool;
    /// Makes all stored blobs survive the end of the process and a loss of power.
    ///
    /// # Errors
    /// A store that cannot be written.
    fn commit(&self) -> Result<(), BlobError>;
}

/// How a file comes into the store.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Keep {
    /// As a copy, which shares the file's blocks where the file system can.
    #[default]
    Copy,
    /// As a link to the file: its bytes stay where they are, and a file that is changed or removed is lost to the store.
    Reference,
}

/// Receives the progress of a run.
pub trait Progress: Sync {
    /// Reports `done` of `total` units. `note` is a short current figure (`loss 0.0123`).
    fn at(&self, done: u64, total: u64, note: &str);
    /// Reports how long a part of the work took (`training`), seconds. Several times of one part add up. The sum is stored
    /// with the record, as information.
    fn took(&self, _part: &'static str, _seconds: f64) {}
    /// Shows the user one sentence about the work. Anything that affects a result must also be in its outputs.
    fn warn(&self, _message: &str) {}
}

/// Keeps the state of an unfinished run under the node's key, in named parts (`training`, `trial-2`). All are removed when
/// the node finishes.
pub trait Checkpoints: Sync {
    /// Returns this part as the last unfinished run of this key saved it, or `None` if it is damaged.
    fn load(&self, part: &str) -> Option<Vec<u8>>;
    /// Replaces a part. A failure costs only time, and the engine reports it.
    fn save(&self, part: &str, state: &[u8]);
}

/// Keeps partial results from run to run under keys that the stage chooses.
///
/// The key must be a digest of everything the value depends on. A memo that is lost, damaged or was never saved costs
/// time, never a result: the stage computes the value again.
pub trait Memos: Sync {
    /// Returns the bytes last saved under this key.
    fn load(&self, key: &Digest) -> Option<Arc<[u8]>>;
    /// Replaces the bytes. A failure costs only time, and the engine reports it.
    fn save(&self, key: &Digest, value: &[u8]);
}

/// A request to stop, shared between threads.
#[derive(Debug, Clone)]
pub struct Cancel(Arc<AtomicU64>);

/// The request is not made, however often it is asked for.
const NOT_REQUESTED: u64 = u64::MAX;

impl Default for Cancel {
    fn default() -> Self {
        Self(Arc::new(AtomicU64::new(NOT_REQUESTED)))
    }
}

impl Cancel {
    /// Returns a request that is made after `checks` checks, for tests that stop a stage anywhere.
    pub fn after(checks: u64) -> Self {
        Self(Arc::new(AtomicU64::new(checks)))
    }

    /// Requests a stop.
    pub fn set(&self) {
        self.0.store(0, Ordering::Relaxed);
    }

    /// Returns whether a stop was requested.
    pub fn is_set(&self) -> bool {
        let left = self.0.load(Ordering::Relaxed);
        if left == NOT_REQUESTED {
            return false;
        }
        let one_less = |left: u64| left.checked_sub(1);
        left == 0
            || self
                .0
                .fetch_update(Ordering::Relaxed, Ordering::Relaxed, one_less)
                .is_err()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_made_by_hand_or_after_a_number_of_checks_and_stays() {
        let (never, after) = (Cancel::default(), Cancel::after(2));
        assert!(!never.is_set());
        assert_eq!(
            [after.is_set(), after.is_set(), after.is_set(), after.is_set()],
            [false, false, true, true]
        );
        never.clone().set();
        assert!(never.is_set());
    }
}

use std::path::Path;
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use marf_cache::Digest;

use crate::StageError;

/// What a running stage may use of the outside.
#[derive(Clone, Copy)]
pub struct Ctx<'a> {
    /// The store.
    pub blobs: &'a dyn Blobs,
    /// The wish to stop.
    pub cancel: &'a Cancel,
    /// Who wants to know how far it is.
    pub progress: &'a dyn Progress,
    /// A place for the state of an unfinished run of this very key.
    pub checkpoints: &'a dyn Checkpoints,
    /// Tables of partial results that outlive this run.
    pub memos: &'a dyn Memos,
    /// A folder for files of unfinished work (half a download, what a server last listed), made by who first needs it.
    /// What lies there may vanish between runs and never reaches a result.
    pub scratch: &'a Path,
    /// Threads given to this run; a rayon pool of that size is installed. Never part of a result.
    pub threads: usize,
}

impl Ctx<'_> {
    /// Stops here if the user asked to.
    ///
    /// # Errors
    /// [`StageError::Cancelled`] then.
    pub fn check(&self) -> Result<(), StageError> {
        if self.cancel.is_set() {
            Err(StageError::Cancelled)
        } else {
            Ok(())
        }
    }

    /// Reads a blob; its bytes have been verified.
    ///
    /// # Errors
    /// A missing or damaged blob.
    pub fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, StageError> {
        Ok(self.blobs.get(digest)?)
    }

    /// Stores a blob and returns its name.
    ///
    /// # Errors
    /// A store that cannot be written.
    pub fn put(&self, bytes: &[u8]) -> Result<Digest, StageError> {
        Ok(self.blobs.put(bytes)?)
    }
}

/// Byte strings by digest.
pub trait Blobs: Sync {
    /// Reads and verifies.
    ///
    /// # Errors
    /// A missing or damaged blob.
    fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, BlobError>;
    /// Stores; storing the same bytes twice is one blob.
    ///
    /// # Errors
    /// A store that cannot be written.
    fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError>;
}

/// A blob that could not be read or written.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{message}")]
pub struct BlobError {
    /// Path, numbers and cause in one line.
    pub message: String,
    /// The blob that was asked for and is missing or damaged, so that its producer can run again.
    pub lost: Option<Digest>,
}

/// Hears how far a run is.
pub trait Progress: Sync {
    /// `done` of `total` units; `note` is a short figure of the moment (`loss 0.0123`).
    fn at(&self, done: u64, total: u64, note: &str);
}

/// Keeps the state of an unfinished run, by the node's key.
pub trait Checkpoints: Sync {
    /// Returns what the last unfinished run of this key saved.
    fn load(&self) -> Option<Vec<u8>>;
    /// Replaces it. A failure costs only time, and is reported by the engine.
    fn save(&self, state: &[u8]);
}

/// Keeps tables of partial results from run to run, by a key of the stage's own making.
///
/// The key holds all that the table's rows depend on. Losing a memo costs time, never a result: a table that was
/// never saved, or is damaged, is none, and the stage works it out anew.
pub trait Memos: Sync {
    /// Returns the table last saved under this key.
    fn load(&self, key: &Digest) -> Option<Arc<[u8]>>;
    /// Replaces it. A failure costs only time, and is reported by the engine.
    fn save(&self, key: &Digest, table: &[u8]);
}

/// A wish to stop that many threads can see.
#[derive(Debug, Clone, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Asks to stop.
    pub fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Tells whether somebody asked to stop.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

//! Locks between processes: empty files under `locks/`, locked by the operating system and free when their process ends.

use std::{
    fs::{self, File, TryLockError},
    io,
    path::{Path, PathBuf},
    time::Duration,
};

use super::{error::StoreError, notices::Notices};

/// Longest wait for a lock whose holders take seconds at most.
pub(super) const PATIENCE: Duration = Duration::from_secs(600);

/// Purpose of a lock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Lock {
    /// Shared by look-ups of objects to use, exclusive for the deletions of a collection.
    Collect,
    /// Exclusive while packs are rewritten: merge, repair, compaction. Its holder never waits for `Collect`.
    Rewrite,
    /// Exclusive for a whole collection.
    Gc,
    /// Shared while the index is opened, exclusive while it is created or replaced.
    Index,
    /// Exclusive while a run is numbered.
    Runs,
    /// Held exclusively while the file `format` is written.
    Format,
}

/// With how many others a lock is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Share {
    Shared,
    Exclusive,
}

/// The lock files of a store.
pub(super) struct Locks {
    dir: PathBuf,
}

/// A lock that is held until this is dropped.
#[must_use]
pub(super) struct Guard(
    #[expect(dead_code, reason = "the file holds the lock while it is open")] Option<File>,
);

impl Locks {
    /// Returns the locks of the store in a folder. Opens nothing.
    pub(super) fn new(root: &Path) -> Self {
        Self {
            dir: root.join("locks"),
        }
    }

    /// Waits for a lock until the caller interrupts.
    pub(super) fn take(&self, lock: Lock, share: Share, notices: &Notices) -> Result<Guard, StoreError> {
        let path = self.path(lock);
        let taken = notices.retry(PATIENCE, || self.attempt(lock, share))?;
        taken.map_err(|waited| StoreError::Locked {
            path,
            waited_ms: waited.as_millis() as u64,
        })
    }

    /// Takes a lock if it is free.
    pub(super) fn try_take(&self, lock: Lock, share: Share) -> Result<Option<Guard>, StoreError> {
        self.attempt(lock, share)
    }

    fn path(&self, lock: Lock) -> PathBuf {
        self.dir.join(match lock {
            Lock::Collect => "collect",
            Lock::Rewrite => "rewrite",
            Lock::Gc => "gc",
            Lock::Index => "index",
            Lock::Runs => "runs",
            Lock::Format => "format",
        })
    }

    fn attempt(&self, lock: Lock, share: Share) -> Result<Option<Guard>, StoreError> {
        let path = self.path(lock);
        let file = match create(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                fs::create_dir_all(&self.dir).and_then(|()| create(&path))
            }
            other => other,
        };
        let file = file.map_err(StoreError::io("create", &path))?;
        let locked = match share {
            Share::Shared => file.try_lock_shared(),
            Share::Exclusive => file.try_lock(),
        };
        match locked {
            Ok(()) => Ok(Some(Guard(Some(file)))),
            Err(TryLockError::WouldBlock) => Ok(None),
            // A file system without locks is used by one process at a time.
            Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => {
                Ok(Some(Guard(None)))
            }
            Err(TryLockError::Error(error)) => Err(StoreError::io("lock", &path)(error)),
        }
    }
}

fn create(path: &Path) -> io::Result<File> {
    File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(path)
}

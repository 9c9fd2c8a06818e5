//! Leases: the objects that a running process uses, which a collection must not remove.
//!
//! A lease is a file `leases/<id>` of entries of 33 bytes: `k` and a key, or `b` and the digest of a blob. Its process
//! holds a lock on it until it ends. A look-up of an object to use writes it to the lease first and looks for it
//! afterwards, both under the shared lock of collections. A collection reads the leases and removes objects under the
//! exclusive one. The lease of a process that has ended protects for as long as the grace of a collection lasts.

use std::{
    collections::HashSet,
    fs::File,
    path::{Path, PathBuf},
    time::Duration,
};

use parking_lot::Mutex;

use super::{
    error::StoreError,
    files::{Access, Files},
    locks::{Lock, Locks, Share},
    notices::Notices,
    staging,
};
use crate::Digest;

const ENTRY: usize = 33;
/// Entries remembered as written, so that they are not written again.
const REMEMBERED: usize = 1 << 16;
/// Age at which leases of dead processes are removed without a collection.
const FORGOTTEN: Duration = Duration::from_secs(48 * 3600);

/// An entry of a lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Use {
    Key(Digest),
    Blob(Digest),
}

/// The lease of one open store.
pub(super) struct Lease {
    dir: PathBuf,
    files: Files,
    access: Access,
    open: Mutex<Option<OpenLease>>,
    written: Mutex<HashSet<Use>>,
}

struct OpenLease {
    path: PathBuf,
    /// The lock is held as long as this is open.
    _lock: File,
}

/// A lease that a collection found.
pub(super) struct LeaseFile {
    pub(super) path: PathBuf,
    pub(super) is_alive: bool,
    /// Time since its last entry. `None` if the clock was set back.
    pub(super) age: Option<Duration>,
}

impl Use {
    fn encode(self) -> [u8; ENTRY] {
        let (code, digest) = match self {
            Self::Key(key) => (b'k', key),
            Self::Blob(blob) => (b'b', blob),
        };
        let mut bytes = [code; ENTRY];
        if let Some(rest) = bytes.get_mut(1..) {
            rest.copy_from_slice(digest.as_bytes());
        }
        bytes
    }

    fn decode(bytes: &[u8; ENTRY]) -> Option<Self> {
        let (code, digest) = bytes.split_first()?;
        let digest = Digest::from_bytes(digest.try_into().ok()?);
        match code {
            b'k' => Some(Self::Key(digest)),
            b'b' => Some(Self::Blob(digest)),
            _ => None,
        }
    }
}

impl Lease {
    /// Returns the lease of a store that is being opened. Creates nothing.
    pub(super) fn new(root: &Path, files: Files, access: Access) -> Self {
        Self {
            dir: root.join("leases"),
            files,
            access,
            open: Mutex::default(),
            written: Mutex::default(),
        }
    }

    /// Protects objects from collections, then runs `check`, which looks whether they are there.
    pub(super) fn protect<T>(
        &self,
        uses: &[Use],
        locks: &Locks,
        notices: &Notices,
        check: impl FnOnce() -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        let new: Vec<Use> = {
            let written = self.written.lock();
            uses.iter()
                .filter(|one| !written.contains(*one))
                .copied()
                .collect()
        };
        // Nobody collects a store that cannot be written.
        if new.is_empty() || self.access == Access::ReadOnly {
            return check();
        }
        let _guard = locks.take(Lock::Collect, Share::Shared, notices)?;
        self.append(&new)?;
        check()
    }

    fn append(&self, uses: &[Use]) -> Result<(), StoreError> {
        let bytes: Vec<u8> = uses.iter().flat_map(|one| one.encode()).collect();
        let mut open = self.open.lock();
        let lease = match open.as_mut() {
            Some(lease) => lease,
            None => open.insert(self.create()?),
        };
        self.files.append(&lease.path, &bytes)?;
        let mut written = self.written.lock();
        if written.len() > REMEMBERED {
            written.clear();
        }
        written.extend(uses);
        Ok(())
    }

    fn create(&self) -> Result<OpenLease, StoreError> {
        self.files.create_dir(&self.dir)?;
        let path = self.dir.join(staging::unique_name());
        let lock = File::create(&path).map_err(StoreError::io("create", &path))?;
        // On a file system without locks a collection takes every lease for one of the living.
        let _ = lock.lock();
        Ok(OpenLease { path, _lock: lock })
    }
}

/// Returns the leases of a store.
pub(super) fn list(root: &Path, files: &Files) -> Result<Vec<LeaseFile>, StoreError> {
    let dir = root.join("leases");
    let names = files.names(&dir)?;
    let found = names.into_iter().map(|name| {
        let path = dir.join(name);
        // A file that vanished is not a lease any more: its process removed it.
        let is_alive = File::open(&path).is_ok_and(|file| file.try_lock().is_err());
        let meta = files.meta(&path);
        LeaseFile {
            is_alive,
            age: meta.and_then(|meta| meta.modified.elapsed().ok()),
            path,
        }
    });
    Ok(found.collect())
}

/// Returns the entries of a lease. A cut one ends before the cut.
pub(super) fn read(files: &Files, path: &Path) -> Result<Vec<Use>, StoreError> {
    let bytes = files.read(path)?.unwrap_or_default();
    let (entries, _) = bytes.as_chunks::<ENTRY>();
    Ok(entries.iter().filter_map(Use::decode).collect())
}

/// Removes old leases of dead processes.
pub(super) fn sweep(root: &Path, files: &Files) {
    for lease in list(root, files).unwrap_or_default() {
        if !lease.is_alive && lease.age.is_some_and(|age| age > FORGOTTEN) {
            let _ = files.remove_file(&lease.path);
        }
    }
}

//! The store: blobs (byte strings by their digest), records (results by key), memos and runs.
//!
//! ```text
//! .marf/cas/xx/<62 hex>      blobs from 64 KiB, one file each
//! .marf/packs/<id>.pack .idx smaller blobs, many in one file that never changes
//! .marf/index.redb           records (key -> result) and memos (key -> blob, may be replaced)
//! .marf/runs/NNNNNN.json     one root a run
//! .marf/tmp/<id>/            temporary files of one open store
//! .marf/bad/                 quarantine: damaged blobs
//! .marf/scratch/             files of unfinished work of stages; may be removed at any time
//! ```
//! Order of writes: bytes to the disk, then their names, then the folders, then records, last run roots. So
//! nothing names an object that may be missing, and a crash leaves only objects that nothing names. Writes are
//! collected in a write batch, so that they share the waits for the disk: a batch is committed when it is a
//! second old, at 64 MiB, and when [`Store::commit`] is called.

mod error;
mod files;
mod index;
mod object_store;
mod pack;
mod record;
mod runs;
mod staging;
#[cfg(test)]
mod tests;
mod write_batch;

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use parking_lot::{Mutex, MutexGuard};

use self::{
    index::Index,
    object_store::ObjectStore,
    staging::StagingDir,
    write_batch::{LargeBlob, WriteBatch},
};
use crate::Digest;

pub use error::StoreError;
pub use record::{Conflict, Output, Record, RunMetadata, StoreStat, digest_list, read_digest_list};

/// Blobs from this length on are files of their own.
const LARGE_BYTES: usize = 64 << 10;

/// A store that several threads and processes share.
///
/// This store reads at once what it was given; other processes read it after the next commit. Dropping a store
/// discards what is not committed.
pub struct Store {
    dir: PathBuf,
    objects: ObjectStore,
    index: Index,
    staging: Mutex<Option<Arc<StagingDir>>>,
    pending: Mutex<Pending>,
    commit_lock: Mutex<()>,
    conflicts: Mutex<Vec<Conflict>>,
}

/// What is not committed yet.
#[derive(Default)]
struct Pending {
    /// The batch that takes new writes.
    open: WriteBatch,
    /// The batch that is being written; readable until it is committed.
    committing: Option<Arc<WriteBatch>>,
}

impl Pending {
    /// Returns what `get` finds in the open batch, or else in the one that is being written.
    fn find<T>(&self, get: impl Fn(&WriteBatch) -> Option<T>) -> Option<T> {
        get(&self.open).or_else(|| self.committing.as_deref().and_then(get))
    }
}

impl Store {
    /// Opens the store in this folder (`.marf` itself), creates it if it is absent, and removes the temporary
    /// files of dead processes.
    ///
    /// # Errors
    /// A folder that cannot be made or read.
    pub fn open(dir: impl Into<PathBuf>) -> Result<Self, StoreError> {
        let dir = dir.into();
        for part in ["cas", "packs", "runs", "tmp"] {
            let path = dir.join(part);
            if !path.is_dir() {
                files::create_dir(&path)?;
            }
        }
        staging::sweep(&dir.join("tmp"));
        let objects = ObjectStore::new(&dir);
        objects.refresh()?;
        Ok(Self {
            objects,
            index: Index::new(&dir),
            staging: Mutex::default(),
            pending: Mutex::default(),
            commit_lock: Mutex::default(),
            conflicts: Mutex::default(),
            dir,
        })
    }

    /// Returns the folder of the store.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Returns the folder for files of unfinished work, which may be absent; nothing in it is needed.
    pub fn scratch(&self) -> PathBuf {
        self.dir.join("scratch")
    }

    /// Returns the folder of temporary files. The first write creates it, so that a reader writes nothing.
    fn staging(&self) -> Result<Arc<StagingDir>, StoreError> {
        let mut staging = self.staging.lock();
        if let Some(staging) = staging.as_ref() {
            return Ok(Arc::clone(staging));
        }
        let created = Arc::new(StagingDir::create(&self.dir.join("tmp"))?);
        *staging = Some(Arc::clone(&created));
        Ok(created)
    }

    /// Stores a blob and returns its digest; the same bytes are stored once.
    ///
    /// # Errors
    /// A store that cannot be written; nothing of the blob becomes visible.
    pub fn put(&self, bytes: &[u8]) -> Result<Digest, StoreError> {
        let digest = Digest::of(bytes);
        let is_pending = self.pending.lock().find(|batch| batch.size_of(&digest)).is_some();
        if is_pending || self.objects.knows(&digest) {
            return Ok(digest);
        }
        match bytes.len() {
            0..LARGE_BYTES => self.pending.lock().open.add_small(digest, bytes),
            _ => self.put_large(digest, bytes)?,
        }
        self.commit_if_due()?;
        Ok(digest)
    }

    fn put_large(&self, digest: Digest, bytes: &[u8]) -> Result<(), StoreError> {
        let staging = self.staging()?;
        let path = staging.path(&staging.next_name());
        files::write_new(&path, &[bytes])?;
        let large = LargeBlob {
            path,
            bytes: bytes.len() as u64,
        };
        let mut pending = self.pending.lock();
        match pending.find(|batch| batch.size_of(&digest)) {
            None => pending.open.add_large(digest, large),
            // Another thread put the same bytes meanwhile.
            Some(_) => drop(fs::remove_file(&large.path)),
        }
        Ok(())
    }

    pub fn put_file(&self, path: &Path, max_bytes: u64) -> Result<(Digest, Arc<[u8]>), StoreError> {
        let bytes = fs::read(path).map_err(StoreError::io("read", path))?;
        if bytes.len() as u64 > max_bytes {
            return Err(StoreError::io("read", path)(std::io::Error::other("too large")));
        }
        Ok((self.put(&bytes)?, Arc::from(bytes)))
    }

    pub fn take_warnings(&self) -> Vec<String> {
        Vec::new()
    }

    pub fn set_interrupt(&self, _interrupt: impl Fn() -> bool + Send + Sync + 'static) {}

    fn commit_if_due(&self) -> Result<(), StoreError> {
        if !self.pending.lock().open.is_due() {
            return Ok(());
        }
        // While another thread commits, these writes stay in the open batch.
        match self.commit_lock.try_lock() {
            None => Ok(()),
            Some(guard) => self.commit_open(&guard),
        }
    }

    /// Reads a blob and verifies its digest.
    ///
    /// # Errors
    /// [`StoreError::Missing`], or [`StoreError::Damaged`] once: a damaged blob is quarantined and then missing.
    pub fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, StoreError> {
        let (small, large) = {
            let pending = self.pending.lock();
            let small = pending.find(|batch| batch.small.get(digest).cloned());
            let large = pending.find(|batch| batch.large.get(digest).cloned());
            (small, large)
        };
        if let Some(bytes) = small {
            return Ok(bytes);
        }
        // A temporary file that cannot be read has just got its final name.
        let read = large.and_then(|large| fs::read(large.path).ok());
        match read {
            Some(bytes) if Digest::of(&bytes) == *digest => Ok(Arc::from(bytes)),
            _ => self.objects.get(digest),
        }
    }

    /// Tells whether a blob is in the store, whichever process committed it. Its bytes are not read.
    pub fn contains(&self, digest: &Digest) -> bool {
        self.size_of(digest).is_some()
    }

    /// Returns a blob's length in bytes.
    pub fn size_of(&self, digest: &Digest) -> Option<u64> {
        let pending = self.pending.lock().find(|batch| batch.size_of(digest));
        pending.or_else(|| self.objects.size_of(digest))
    }

    /// Returns the record of a key as it was written.
    ///
    /// # Errors
    /// An index that is locked or cannot be used.
    pub fn record(&self, key: &Digest) -> Result<Option<Record>, StoreError> {
        let pending = self.pending.lock().find(|batch| batch.records.get(key).cloned());
        match pending {
            Some(record) => Ok(Some(record)),
            None => self.index.record(key),
        }
    }

    /// Returns the record of a key if all its outputs are in the store.
    ///
    /// # Errors
    /// As [`Store::record`].
    pub fn hit(&self, key: &Digest) -> Result<Option<Record>, StoreError> {
        Ok(self.record(key)?.filter(|record| self.has_outputs(record)))
    }

    fn has_outputs(&self, record: &Record) -> bool {
        record
            .outputs
            .values()
            .all(|output| self.contains(&output.digest))
    }

    /// Adds a record to the open batch. A committed record of the same key whose outputs are in the store is kept
    /// instead.
    pub fn put_record(&self, record: Record) {
        self.pending.lock().open.add_record(record);
    }

    /// Returns the blob last stored under a memo key.
    ///
    /// # Errors
    /// As [`Store::record`].
    pub fn memo(&self, key: &Digest) -> Result<Option<Digest>, StoreError> {
        let pending = self.pending.lock().find(|batch| batch.memos.get(key).copied());
        match pending {
            Some(blob) => Ok(Some(blob)),
            None => self.index.memo(key),
        }
    }

    /// Adds a memo to the open batch; it replaces an earlier one of the same key.
    pub fn put_memo(&self, key: Digest, blob: Digest, _maker: Digest) {
        self.pending.lock().open.add_memo(key, blob);
    }

    /// Makes everything put so far durable.
    ///
    /// # Errors
    /// The first failed write; everything stays pending and readable, and the next call tries again.
    pub fn commit(&self) -> Result<(), StoreError> {
        let guard = self.commit_lock.lock();
        self.commit_open(&guard)
    }

    /// Commits the open batch; the guard proves that no other thread commits.
    fn commit_open(&self, _guard: &MutexGuard<'_, ()>) -> Result<(), StoreError> {
        let batch = {
            let mut pending = self.pending.lock();
            if pending.open.is_empty() {
                return Ok(());
            }
            let batch = Arc::new(std::mem::take(&mut pending.open));
            pending.committing = Some(Arc::clone(&batch));
            batch
        };
        let written = self.write(&batch);
        let mut pending = self.pending.lock();
        pending.committing = None;
        if written.is_err() {
            pending.open.restore(&batch);
        }
        written
    }

    /// Writes the blobs of a batch, then its records and memos.
    fn write(&self, batch: &WriteBatch) -> Result<(), StoreError> {
        self.objects.write(batch, || self.staging())?;
        if batch.records.is_empty() && batch.memos.is_empty() {
            return Ok(());
        }
        let has_outputs = |record: &Record| self.has_outputs(record);
        let conflicts = self.index.commit(&batch.records, &batch.memos, has_outputs)?;
        self.conflicts.lock().extend(conflicts);
        Ok(())
    }

    /// Returns the conflicts found since the last call: results that came second for their key and differ.
    pub fn take_conflicts(&self) -> Vec<Conflict> {
        std::mem::take(&mut *self.conflicts.lock())
    }

    /// Returns all committed records, sorted by key.
    ///
    /// # Errors
    /// As [`Store::record`].
    pub fn records(&self) -> Result<Vec<Record>, StoreError> {
        self.index.records()
    }

    /// Commits everything put so far, then stores a run's root under the next free number and returns the number.
    ///
    /// # Errors
    /// A store that cannot be written.
    pub fn put_run(&self, bytes: &[u8]) -> Result<u64, StoreError> {
        self.commit()?;
        let staging = self.staging()?;
        let file = staging.path(&staging.next_name());
        files::write_new(&file, &[bytes])?;
        files::sync(std::slice::from_ref(&file))?;
        runs::publish(&self.runs_dir(), &file)
    }

    /// Returns the numbers of all runs, oldest first.
    ///
    /// # Errors
    /// A folder that cannot be read.
    pub fn run_numbers(&self) -> Result<Vec<u64>, StoreError> {
        runs::numbers(&self.runs_dir())
    }

    /// Reads a run's root.
    ///
    /// # Errors
    /// A number without a run, or a file that cannot be read.
    pub fn run(&self, number: u64) -> Result<Vec<u8>, StoreError> {
        runs::read(&self.runs_dir(), number)
    }

    fn runs_dir(&self) -> PathBuf {
        self.dir.join("runs")
    }

    /// Counts what is committed.
    ///
    /// # Errors
    /// A folder or an index that cannot be read.
    pub fn stat(&self) -> Result<StoreStat, StoreError> {
        let count = self.objects.count()?;
        let (records, memos) = self.index.count()?;
        Ok(StoreStat {
            loose_blobs: count.loose,
            loose_bytes: count.loose_bytes,
            packs: count.packs,
            packed_blobs: count.packed,
            packed_bytes: count.packed_bytes,
            records,
            memos,
            runs: self.run_numbers()?.len() as u64,
            index_bytes: self.index.bytes(),
            quarantined: count.quarantined,
        })
    }
}

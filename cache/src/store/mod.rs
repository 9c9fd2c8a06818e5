//! The store: blobs (byte strings by their digest), records (results by key), memos and runs.
//!
//! ```text
//! .marf/format                   version of the form of the store
//! .marf/cas/xx/<62 hex>          blobs from 64 KiB, one read-only file each
//! .marf/packs/<id>.pack          smaller blobs, records and memos, many in one file that never changes
//! .marf/index.sqlite             where each object is in the packs
//! .marf/runs/NNNNNN-<hex>.json   one root a run, with its digest in its name
//! .marf/leases/<id>              objects that a running process uses
//! .marf/locks/                   empty files that processes lock
//! .marf/tmp/<id>/                temporary files of one open store
//! .marf/bad/                     quarantine: damaged files
//! .marf/checkpoints/<key>/       state of unfinished work, until it has a result or a collection finds it given up
//! .marf/scratch/                 files of unfinished work of stages, which may be removed at any time
//! ```
//!
//! # What is truth
//! Loose files and packs, and nothing else: they never change, and each object in them proves itself, a blob by its
//! digest, a record or memo by a checksum over key and content. The index can be rebuilt from the packs at any time.
//! Each of its entries is checked against the pack before use.
//!
//! # Order of writes
//! A batch collects writes, so that they share the waits for the disk. It is committed when it is a second old, at 64
//! MiB, and by [`Store::commit`].
//!
//! A commit writes in this order, each step durable before the next:
//! - the lease
//! - the large blobs under temporary names, then their names and folders
//! - one pack with everything small, then its name and folder
//! - the rows of the index in one transaction
//!
//! Run roots come after everything they name. So nothing names an object that may be missing.
//!
//! # What happens in a crash
//! - Before a name: a file in `tmp/`, which the next open store removes.
//! - Between large blobs and pack: blobs that nothing names.
//! - Between pack and index: whoever looks next registers the pack.
//! - In a transaction of the index: SQLite rolls it back. After a loss of power the index may lack the last
//!   transactions, and the packs are registered again.
//! - In a merge, a repair or a collection: the objects of a pack are in two packs. The index knows one of them, and
//!   the next collection removes the other.
//!
//! # What happens to damage
//! It is found when the object is read. A loose file is moved to `bad/`. A pack is moved there after its undamaged
//! objects were written to a new one. An index is moved there and rebuilt from the packs. The object is then missing,
//! its record a miss, and its producer runs again. None of this is an error of the store.
//!
//! # Several processes
//! Readers take no lock. A look-up that is a promise to use what was found ([`Store::hit`], [`Store::memo`], a
//! [`Store::put`] of stored bytes) is written to the lease first (see [`Store::gc`]). Commits wait for each other in the
//! index alone, for seconds at most: rows that cannot be written then are kept in memory and registered later.

mod belongings;
mod census;
mod closure;
mod commit;
mod error;
mod files;
mod format;
mod fsck;
mod gc;
mod index;
mod lease;
mod locks;
mod mark;
mod merge;
mod missing;
mod notices;
mod objects;
mod open;
mod pack;
mod put;
mod read_share;
mod record;
mod runs;
mod sets;
mod staging;
mod stat;
#[cfg(test)]
mod tests;
mod upstream;
mod write_batch;

use std::{
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicBool},
};

use parking_lot::{Mutex, MutexGuard};

use self::{
    files::{Access, Files},
    lease::Use,
    notices::Notices,
    objects::Objects,
    pack::Kind,
    write_batch::{Memo, WriteBatch},
};
use crate::Digest;

pub use belongings::Belongings;
pub use closure::Closure;
pub use error::StoreError;
pub use fsck::{Fault, FsckOptions, FsckReport, LostDocument};
pub use gc::{GcPlan, GcReport, Roots};
pub use missing::MissingObject;
pub use read_share::ReadShare;
pub use record::{Conflict, Output, Record, RunMetadata, StoreStat, digest_list, read_digest_list};
pub use sets::SetError;
pub use stat::StageStat;
pub use upstream::Upstream;

/// A store that several threads and processes share.
///
/// This store reads its own writes at once. Other processes read them after the next commit. Dropping a store
/// discards what is not committed.
pub struct Store {
    dir: PathBuf,
    objects: Objects,
    pending: Mutex<PendingWrites>,
    commit_lock: Mutex<()>,
    conflicts: Mutex<Vec<Conflict>>,
    /// Set when the file system turned out to have no copies that share blocks.
    has_no_reflinks: AtomicBool,
    /// Source of blobs that it lacks. `None` for most stores.
    upstream: Option<Arc<dyn Upstream>>,
}

/// Uncommitted writes.
#[derive(Default)]
struct PendingWrites {
    /// The batch that takes new writes.
    open: WriteBatch,
    /// The batch that is being written. It is readable until it is committed.
    committing: Option<Arc<WriteBatch>>,
}

impl PendingWrites {
    /// Returns what `get` finds in the open batch, or else in the one that is being written.
    fn find<T>(&self, get: impl Fn(&WriteBatch) -> Option<T>) -> Option<T> {
        get(&self.open).or_else(|| self.committing.as_deref().and_then(get))
    }
}

impl Store {
    /// Opens the store in this folder (`.marf` itself), creates it if it is absent, and removes the temporary
    /// files of dead processes.
    ///
    /// A store without permission to write is opened and read without any write.
    ///
    /// # Errors
    /// A folder that cannot be made or read, and a store of a later form ([`StoreError::Newer`]).
    pub fn open(dir: impl Into<PathBuf>) -> Result<Self, StoreError> {
        Self::open_on(dir.into(), Files::of_disk(), Notices::default())
    }

    /// As [`Store::open`]. Whenever the store waits for another program, now or later, `interrupt` decides whether the
    /// wait ends.
    ///
    /// # Errors
    /// As [`Store::open`], and [`StoreError::Locked`] if the wait was ended.
    pub fn open_interruptible(
        dir: impl Into<PathBuf>,
        interrupt: impl Fn() -> bool + Send + Sync + 'static,
    ) -> Result<Self, StoreError> {
        Self::open_on(dir.into(), Files::of_disk(), Notices::to(interrupt))
    }

    fn open_on(dir: PathBuf, files: Files, notices: Notices) -> Result<Self, StoreError> {
        let found = format::find(&files, &dir)?;
        format::check(&dir, found)?;
        let notices = Arc::new(notices);
        let access = open::access_of(&dir);
        if access == Access::ReadWrite {
            open::prepare(&dir, &files, found, &notices)?;
        }
        Ok(Self {
            objects: Objects::open(&dir, access, files, notices)?,
            dir,
            pending: Mutex::default(),
            commit_lock: Mutex::default(),
            conflicts: Mutex::default(),
            has_no_reflinks: AtomicBool::new(false),
            upstream: None,
        })
    }

    /// Returns its folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Returns the folder for files of unfinished work, which may be absent.
    pub fn scratch(&self) -> PathBuf {
        self.dir.join("scratch")
    }

    /// Returns the folder with a folder of checkpoints for each key, which may be absent.
    pub fn checkpoints(&self) -> PathBuf {
        self.dir.join("checkpoints")
    }

    /// Returns whether the store was opened without permission to write.
    pub fn is_read_only(&self) -> bool {
        self.objects.access == Access::ReadOnly
    }

    /// Returns the warnings since the last call that are not errors: repairs, an index that is locked.
    pub fn take_warnings(&self) -> Vec<String> {
        self.objects.notices.take()
    }

    /// Returns the conflicts found since the last call: different results for one key.
    pub fn take_conflicts(&self) -> Vec<Conflict> {
        std::mem::take(&mut *self.conflicts.lock())
    }

    fn commit_if_due(&self) -> Result<(), StoreError> {
        if !self.pending.lock().open.is_due() {
            return Ok(());
        }
        // While another thread commits, these writes stay in the open batch.
        let written = match self.commit_lock.try_lock() {
            None => return Ok(()),
            Some(guard) => self.commit_open(&guard)?,
        };
        self.merge_after(written);
        Ok(())
    }

    /// Reads a blob and verifies its digest. A missing one comes from upstream, if the store has one.
    ///
    /// # Errors
    /// [`StoreError::Missing`], or [`StoreError::Damaged`] once: a damaged blob is quarantined and then missing.
    /// [`StoreError::Upstream`].
    pub fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, StoreError> {
        match self.get_own(digest) {
            Err(error) if error.lost().is_some() => self.get_upstream(digest)?.ok_or(error),
            read => read,
        }
    }

    fn get_own(&self, digest: &Digest) -> Result<Arc<[u8]>, StoreError> {
        let (small, large) = {
            let pending = self.pending.lock();
            let small = pending.find(|batch| batch.small.get(digest).cloned());
            let large = pending.find(|batch| batch.large.get(digest).cloned());
            (small, large)
        };
        if let Some(bytes) = small {
            return Ok(bytes);
        }
        // A temporary file that is gone has just got its final name.
        let read = large.and_then(|large| self.objects.files.read(&large.path).ok().flatten());
        match read {
            Some(bytes) if Digest::from_content(&bytes) == *digest => Ok(Arc::from(bytes)),
            _ => self.objects.get(digest),
        }
    }

    /// Returns whether a blob is in the store, whichever process committed it. Its bytes are not read.
    pub fn contains(&self, digest: &Digest) -> bool {
        let pending = self.pending.lock().find(|batch| batch.size_of(digest));
        pending.is_some() || self.objects.contains(digest)
    }

    /// Returns a blob's length in bytes. One that only upstream has is read for it.
    pub fn size_of(&self, digest: &Digest) -> Option<u64> {
        let pending = self.pending.lock().find(|batch| batch.size_of(digest));
        let own = pending.or_else(|| self.objects.size_of(digest));
        own.or_else(|| Some(self.get_upstream(digest).ok()??.len() as u64))
    }

    /// Returns the record of a key as it was written, or `None` if it is missing or damaged. Damage adds a
    /// warning.
    ///
    /// # Errors
    /// Returns an error if another program keeps the index locked, or if a pack cannot be read.
    pub fn record(&self, key: &Digest) -> Result<Option<Record>, StoreError> {
        let pending = self.pending.lock().find(|batch| batch.records.get(key).cloned());
        match pending {
            Some(record) => Ok(Some(record)),
            None => commit::record_of(&self.objects, key),
        }
    }

    /// Returns the record of a key if its outputs, its list of needs and its set of parts are in the store. Until this
    /// store is dropped no collection removes them or what they name.
    ///
    /// # Errors
    /// As [`Store::record`].
    pub fn hit(&self, key: &Digest) -> Result<Option<Record>, StoreError> {
        self.protect(Use::Key(*key), || {
            let is_complete = |record: &Record| record.objects().all(|digest| self.contains(&digest));
            Ok(self.record(key)?.filter(is_complete))
        })
    }

    /// Adds a record to the open batch. A committed record of the same key whose outputs are in the store is kept
    /// instead.
    pub fn put_record(&self, record: Record) {
        self.pending.lock().open.add_record(record);
    }

    /// Returns the blob last stored under a memo key if it is in the store, which it then stays until this store is
    /// dropped.
    ///
    /// # Errors
    /// As [`Store::record`].
    pub fn memo(&self, key: &Digest) -> Result<Option<Digest>, StoreError> {
        self.protect(Use::Key(*key), || {
            let pending = self.pending.lock().find(|batch| batch.memos.get(key).copied());
            let memo = match pending {
                Some(memo) => Some(memo),
                None => commit::memo_of(&self.objects, key)?,
            };
            Ok(memo.map(|memo| memo.blob).filter(|blob| self.contains(blob)))
        })
    }

    /// Adds a memo to the open batch, and replaces an earlier one of the same key. It lives as long as the result of
    /// the action of key `maker`.
    pub fn put_memo(&self, key: Digest, blob: Digest, maker: Digest) {
        self.pending.lock().open.add_memo(key, Memo { blob, maker });
    }

    /// Makes everything put so far durable.
    ///
    /// # Errors
    /// Returns the first failed write. Everything stays pending and readable, and the next call tries again. A locked
    /// index is not an error: see [`Store::take_warnings`].
    pub fn commit(&self) -> Result<(), StoreError> {
        let written = {
            let guard = self.commit_lock.lock();
            self.commit_open(&guard)?
        };
        self.merge_after(written);
        Ok(())
    }

    /// Commits the open batch and returns whether it held anything. The guard proves that no other thread commits.
    fn commit_open(&self, _guard: &MutexGuard<'_, ()>) -> Result<bool, StoreError> {
        let batch = {
            let mut pending = self.pending.lock();
            if pending.open.is_empty() {
                return Ok(false);
            }
            let batch = Arc::new(std::mem::take(&mut pending.open));
            pending.committing = Some(Arc::clone(&batch));
            batch
        };
        let written = commit::write(&self.objects, &batch);
        let mut pending = self.pending.lock();
        pending.committing = None;
        match written {
            Ok(conflicts) => self.conflicts.lock().extend(conflicts),
            Err(error) => {
                pending.open.restore(&batch);
                return Err(error);
            }
        }
        Ok(true)
    }

    fn merge_after(&self, written: bool) {
        if !written {
            return;
        }
        if let Err(error) = merge::merge(&self.objects) {
            self.objects
                .notices
                .warn(format!("packs could not be merged: {error}"));
        }
    }

    /// Returns all committed records, sorted by key.
    ///
    /// # Errors
    /// As [`Store::record`].
    pub fn records(&self) -> Result<Vec<Record>, StoreError> {
        let keys = self.objects.index.ids(Kind::Record)?;
        let records = keys.iter().map(|key| commit::record_of(&self.objects, key));
        records.filter_map(Result::transpose).collect()
    }
}

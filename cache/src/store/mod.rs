//! The store: blobs by digest, records by key, tables of measures, run roots.
//!
//! ```text
//! .marf/cas/xx/<62 hex>      blobs from 64 KiB, one file each
//! .marf/packs/<id>.pack .idx smaller blobs, many a file, never changed after sealing
//! .marf/index.redb           records (key -> what came out) and memos (key -> blob, may be replaced)
//! .marf/runs/NNNNNN.json     one root a run
//! .marf/tmp/<id>/            unfinished files of a live process
//! .marf/bad/                 damaged blobs, set aside
//! .marf/scratch/             what stages keep of unfinished work; nothing needs it
//! ```
//! Order of writes: bytes to the disk, then their names, then the folders, only then records, last run roots.
//! So nothing ever points at what may not be there, and a crash leaves orphans only. All of a group share the
//! waits: a group is sealed about each second, at 64 MiB, and when [`Store::commit`] is called.

mod error;
mod files;
mod group;
mod index;
mod pack;
mod record;
mod runs;
mod session;
mod shelf;
#[cfg(test)]
mod tests;

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use parking_lot::{Mutex, MutexGuard};

use self::{
    files::Published,
    group::{Group, Large},
    index::Index,
    session::Session,
    shelf::Shelf,
};
use crate::Digest;

pub use error::StoreError;
pub use record::{Conflict, Output, Record, RunMetadata, StoreStat};

/// Blobs from this length on are files of their own.
const LARGE_BYTES: usize = 64 << 10;

/// A store that several threads and processes share.
///
/// What is put can be read at once by this store, and by other processes after the group is sealed. Dropping a
/// store forgets what is not sealed.
pub struct Store {
    dir: PathBuf,
    shelf: Shelf,
    index: Index,
    session: Mutex<Option<Arc<Session>>>,
    staged: Mutex<Staged>,
    sealing: Mutex<()>,
    conflicts: Mutex<Vec<Conflict>>,
}

#[derive(Default)]
struct Staged {
    open: Group,
    /// The group on its way to the disk; readable until it is there.
    leaving: Option<Arc<Group>>,
}

impl Staged {
    fn find<T>(&self, look: impl Fn(&Group) -> Option<T>) -> Option<T> {
        look(&self.open).or_else(|| self.leaving.as_deref().and_then(look))
    }
}

impl Store {
    /// Opens the store in this folder (`.marf` itself), making it if need be, and removes what dead processes
    /// left unfinished.
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
        session::sweep(&dir.join("tmp"));
        let shelf = Shelf::new(&dir);
        shelf.refresh()?;
        Ok(Self {
            shelf,
            index: Index::new(&dir),
            session: Mutex::default(),
            staged: Mutex::default(),
            sealing: Mutex::default(),
            conflicts: Mutex::default(),
            dir,
        })
    }

    /// Returns the folder of the store.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Returns the folder for files of unfinished work, which may not be there yet; nothing in it is needed.
    pub fn scratch(&self) -> PathBuf {
        self.dir.join("scratch")
    }

    /// The first write makes our folder of temporary files: a reader makes none.
    fn session(&self) -> Result<Arc<Session>, StoreError> {
        let mut session = self.session.lock();
        if let Some(session) = session.as_ref() {
            return Ok(Arc::clone(session));
        }
        let begun = Arc::new(Session::begin(&self.dir.join("tmp"))?);
        *session = Some(Arc::clone(&begun));
        Ok(begun)
    }

    /// Stores bytes and returns their name; the same bytes are stored once.
    ///
    /// # Errors
    /// A store that cannot be written; nothing of it becomes visible.
    pub fn put(&self, bytes: &[u8]) -> Result<Digest, StoreError> {
        let digest = Digest::of(bytes);
        let staged = self.staged.lock().find(|group| group.size_of(&digest)).is_some();
        if staged || self.shelf.knows(&digest) {
            return Ok(digest);
        }
        match bytes.len() {
            0..LARGE_BYTES => self.staged.lock().open.add_small(digest, bytes),
            _ => self.put_large(digest, bytes)?,
        }
        self.commit_if_due()?;
        Ok(digest)
    }

    fn put_large(&self, digest: Digest, bytes: &[u8]) -> Result<(), StoreError> {
        let session = self.session()?;
        let path = session.path(&session.next_name());
        files::write_new(&path, &[bytes])?;
        let large = Large {
            path,
            bytes: bytes.len() as u64,
        };
        let mut staged = self.staged.lock();
        match staged.find(|group| group.size_of(&digest)) {
            None => staged.open.add_large(digest, large),
            // Another thread put the same bytes meanwhile.
            Some(_) => drop(fs::remove_file(&large.path)),
        }
        Ok(())
    }

    fn commit_if_due(&self) -> Result<(), StoreError> {
        if !self.staged.lock().open.is_due() {
            return Ok(());
        }
        // Where another thread is sealing, these blobs go with the next batch.
        match self.sealing.try_lock() {
            None => Ok(()),
            Some(gate) => self.seal_open(&gate),
        }
    }

    /// Reads a blob; its bytes have been verified.
    ///
    /// # Errors
    /// [`StoreError::Missing`], or [`StoreError::Damaged`] once: a damaged blob is set aside and then missing.
    pub fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, StoreError> {
        let (small, large) = {
            let staged = self.staged.lock();
            let small = staged.find(|group| group.small.get(digest).cloned());
            let large = staged.find(|group| group.large.get(digest).cloned());
            (small, large)
        };
        if let Some(bytes) = small {
            return Ok(bytes);
        }
        // A temporary file may get its final name at this very moment; then the shelf has it.
        let read = large.and_then(|large| fs::read(large.path).ok());
        match read {
            Some(bytes) if Digest::of(&bytes) == *digest => Ok(Arc::from(bytes)),
            _ => self.shelf.get(digest),
        }
    }

    /// Tells whether a blob is here, also one another process has sealed. Its bytes are not looked at.
    pub fn contains(&self, digest: &Digest) -> bool {
        self.size_of(digest).is_some()
    }

    /// Returns a blob's length in bytes.
    pub fn size_of(&self, digest: &Digest) -> Option<u64> {
        let staged = self.staged.lock().find(|group| group.size_of(digest));
        staged.or_else(|| self.shelf.size_of(digest))
    }

    /// Returns the record of a key as it was written.
    ///
    /// # Errors
    /// An index that is locked or cannot be used.
    pub fn record(&self, key: &Digest) -> Result<Option<Record>, StoreError> {
        let staged = self.staged.lock().find(|group| group.records.get(key).cloned());
        match staged {
            Some(record) => Ok(Some(record)),
            None => self.index.record(key),
        }
    }

    /// Returns the record of a key if all its outputs are here: otherwise it is a miss.
    ///
    /// # Errors
    /// As [`Store::record`].
    pub fn hit(&self, key: &Digest) -> Result<Option<Record>, StoreError> {
        Ok(self.record(key)?.filter(|record| self.lives(record)))
    }

    fn lives(&self, record: &Record) -> bool {
        record
            .outputs
            .values()
            .all(|output| self.contains(&output.digest))
    }

    /// Stages a record for the next group; where the key has a record whose outputs are here, that one stays.
    pub fn put_record(&self, record: Record) {
        self.staged.lock().open.add_record(record);
    }

    /// Returns the blob last stored under a memo key.
    ///
    /// # Errors
    /// As [`Store::record`].
    pub fn memo(&self, key: &Digest) -> Result<Option<Digest>, StoreError> {
        let staged = self.staged.lock().find(|group| group.memos.get(key).copied());
        match staged {
            Some(blob) => Ok(Some(blob)),
            None => self.index.memo(key),
        }
    }

    /// Stages a memo for the next group; it replaces an earlier one.
    pub fn put_memo(&self, key: Digest, blob: Digest) {
        self.staged.lock().open.add_memo(key, blob);
    }

    /// Seals everything put so far.
    ///
    /// # Errors
    /// What stopped it; everything stays staged and readable, and the next call tries again.
    pub fn commit(&self) -> Result<(), StoreError> {
        let gate = self.sealing.lock();
        self.seal_open(&gate)
    }

    fn seal_open(&self, _gate: &MutexGuard<'_, ()>) -> Result<(), StoreError> {
        let group = {
            let mut staged = self.staged.lock();
            if staged.open.is_empty() {
                return Ok(());
            }
            let group = Arc::new(std::mem::take(&mut staged.open));
            staged.leaving = Some(Arc::clone(&group));
            group
        };
        let sealed = self.seal(&group);
        let mut staged = self.staged.lock();
        staged.leaving = None;
        if sealed.is_err() {
            staged.open.take_back(&group);
        }
        sealed
    }

    fn seal(&self, group: &Group) -> Result<(), StoreError> {
        self.seal_blobs(group)?;
        if group.records.is_empty() && group.memos.is_empty() {
            return Ok(());
        }
        let lives = |record: &Record| self.lives(record);
        let conflicts = self.index.commit(&group.records, &group.memos, lives)?;
        self.conflicts.lock().extend(conflicts);
        Ok(())
    }

    /// Bytes, then names, then folders.
    fn seal_blobs(&self, group: &Group) -> Result<(), StoreError> {
        let mut unsynced: Vec<PathBuf> = group.large.values().map(|large| large.path.clone()).collect();
        unsynced.retain(|path| path.exists()); // named by a try that failed later
        let mut folders = BTreeSet::new();
        let pack = self.write_pack(group)?;
        if let Some(pack) = &pack {
            unsynced.extend([pack.file.clone(), pack.file.with_extension("idx")]);
        }
        files::sync(&unsynced)?;
        for (digest, large) in &group.large {
            self.name_large(digest, large, &mut folders)?;
        }
        if let Some(pack) = &pack {
            let to = self.shelf.packs_dir().join(&pack.name);
            files::publish(&pack.file, &to.with_extension("pack"))?;
            files::publish(&pack.file.with_extension("idx"), &to.with_extension("idx"))?;
            folders.insert(self.shelf.packs_dir());
        }
        files::sync(&folders.into_iter().collect::<Vec<_>>())?;
        if let Some(pack) = pack {
            self.shelf.add(&pack.name, &pack.entries);
        }
        Ok(())
    }

    fn write_pack(&self, group: &Group) -> Result<Option<NewPack>, StoreError> {
        if group.small.is_empty() {
            return Ok(None);
        }
        let session = self.session()?;
        let name = session.next_name();
        let file = session.path(&format!("{name}.pack"));
        let entries = pack::write(&file, &file.with_extension("idx"), &group.small)?;
        Ok(Some(NewPack { name, file, entries }))
    }

    fn name_large(
        &self,
        digest: &Digest,
        large: &Large,
        folders: &mut BTreeSet<PathBuf>,
    ) -> Result<(), StoreError> {
        let to = self.shelf.loose_path(digest);
        if to.exists() {
            let _ = fs::remove_file(&large.path);
            return Ok(());
        }
        let Some(folder) = to.parent() else { return Ok(()) };
        if !folder.is_dir() {
            files::create_dir(folder)?;
            folders.insert(self.dir.join("cas"));
        }
        if files::publish(&large.path, &to)? == Published::New {
            folders.insert(folder.to_owned());
        }
        Ok(())
    }

    /// Hands over the results that came second for their key and differ, each once.
    pub fn conflicts(&self) -> Vec<Conflict> {
        std::mem::take(&mut *self.conflicts.lock())
    }

    /// Returns all sealed records, sorted by key.
    ///
    /// # Errors
    /// As [`Store::record`].
    pub fn records(&self) -> Result<Vec<Record>, StoreError> {
        self.index.records()
    }

    /// Counts what is sealed.
    ///
    /// # Errors
    /// A folder or an index that cannot be read.
    pub fn stat(&self) -> Result<StoreStat, StoreError> {
        let count = self.shelf.count()?;
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

/// A pack under its temporary name.
struct NewPack {
    name: String,
    file: PathBuf,
    entries: Vec<pack::Entry>,
}

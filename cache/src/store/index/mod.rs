//! The index: where each blob, record and memo is in the packs, in one SQLite file shared by several processes.
//!
//! It holds nothing that the packs do not hold. Packs that it lacks are adopted, rows of packs that are gone are
//! dropped, and a file that is damaged is moved to `bad/` and made again. What cannot be written to the file now, because
//! another program keeps it locked or the disk is full, is in the same tables in memory until it can.

mod changes;
mod connection;
mod repair;
mod tables;

use std::{
    collections::BTreeSet,
    io::ErrorKind,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, SystemTime},
};

use parking_lot::Mutex;
use rusqlite::{Connection, TransactionBehavior};

use self::connection::{FileId, Handle, Trouble};
use super::{
    error::StoreError,
    files::{Access, Files},
    locks::{Lock, Locks, Share},
    notices::Notices,
    pack::{self, Entry, Kind},
};
use crate::Digest;

pub(super) use tables::{Location, ObjectRow, PackRewrite};

/// Longest wait of a reader. Readers wait only for a program that has locked the whole file.
const READ_PATIENCE: Duration = Duration::from_secs(60);
/// Longest wait of a commit before its rows stay in memory.
const WRITE_PATIENCE: Duration = Duration::from_secs(5);
/// Times of folders change in steps of up to 10 ms.
const CLOCK_STEP: Duration = Duration::from_millis(50);
/// Attempts to read an index that others repair at the same time.
const ATTEMPTS: usize = 4;

/// Locations of objects.
pub(super) struct Index {
    root: PathBuf,
    path: PathBuf,
    files: Files,
    locks: Arc<Locks>,
    notices: Arc<Notices>,
    access: Access,
    write_patience: Mutex<Duration>,
    reader: Mutex<Option<Handle>>,
    writer: Mutex<Option<Handle>>,
    memory: Mutex<Option<Connection>>,
    /// Time of the folder of packs when all were registered.
    seen: Mutex<Option<SystemTime>>,
    /// Set when the file can neither be used nor replaced. Everything is then in memory.
    is_disabled: AtomicBool,
}

impl Index {
    /// Returns the index in the folder of a store, with all packs registered.
    pub(super) fn open(
        root: &Path,
        access: Access,
        files: Files,
        locks: Arc<Locks>,
        notices: Arc<Notices>,
    ) -> Result<Self, StoreError> {
        let index = Self {
            root: root.to_owned(),
            path: root.join("index.sqlite"),
            files,
            locks,
            notices,
            access,
            write_patience: Mutex::new(WRITE_PATIENCE),
            reader: Mutex::default(),
            writer: Mutex::default(),
            memory: Mutex::default(),
            seen: Mutex::default(),
            is_disabled: AtomicBool::new(false),
        };
        index.refresh(index.patience())?;
        Ok(index)
    }

    /// Sets how long a commit waits before its rows stay in memory.
    #[cfg(test)]
    pub(super) fn set_patience(&self, patience: Duration) {
        *self.write_patience.lock() = patience;
    }

    fn patience(&self) -> Duration {
        *self.write_patience.lock()
    }

    /// Returns the length of the file and its log.
    pub(super) fn bytes(&self) -> u64 {
        let of = |path: &Path| self.files.meta(path).map_or(0, |meta| meta.bytes);
        of(&self.path) + of(&self.beside("-wal"))
    }

    fn beside(&self, suffix: &str) -> PathBuf {
        let mut name = self.path.clone().into_os_string();
        name.push(suffix);
        name.into()
    }

    fn packs_dir(&self) -> PathBuf {
        self.root.join("packs")
    }

    /// Returns the names of all pack files.
    pub(super) fn listed(&self) -> Result<BTreeSet<String>, StoreError> {
        let mut names = self.files.names(&self.packs_dir())?;
        names.retain(|name| name.ends_with(".pack"));
        Ok(names.into_iter().collect())
    }

    /// Returns where an object is, also if another process has just stored it.
    pub(super) fn locate(&self, kind: Kind, id: &Digest) -> Result<Option<Location>, StoreError> {
        if let Some(location) = self.locate_known(kind, id)? {
            return Ok(Some(location));
        }
        if !self.has_new_packs() || !self.refresh(Duration::ZERO)? {
            return Ok(None);
        }
        self.locate_known(kind, id)
    }

    /// Returns where an object is, without a look for packs that were added without their rows.
    pub(super) fn locate_known(&self, kind: Kind, id: &Digest) -> Result<Option<Location>, StoreError> {
        let on_disk = self.read(|connection| tables::locate(connection, kind, id))?;
        if let Some(location) = on_disk.flatten() {
            return Ok(Some(location));
        }
        Ok(self
            .in_memory(|connection| tables::locate(connection, kind, id))
            .flatten())
    }

    /// Runs a query on the file, or returns `None` if there is no usable file.
    fn read<T>(&self, query: impl Fn(&Connection) -> rusqlite::Result<T>) -> Result<Option<T>, StoreError> {
        for _ in 0..ATTEMPTS {
            if self.is_disabled.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let mut broken = None;
            let answer = self.notices.retry(READ_PATIENCE, || {
                match self.with_connection(&self.reader, |connection| query(connection)) {
                    Ok(value) => Ok(Some(Some(value))),
                    Err(Trouble::Busy) => Ok(None),
                    Err(trouble) => {
                        broken = Some(trouble);
                        Ok::<_, StoreError>(Some(None))
                    }
                }
            })?;
            match (answer, broken) {
                (Ok(Some(value)), _) => return Ok(Some(value)),
                (Ok(None), Some(Trouble::Broken(message))) => self.rebuild(&message)?,
                (Ok(None), Some(Trouble::Unusable(message))) => self.disable(&message)?,
                (Ok(None), _) => {}
                (Err(waited), _) => return Err(self.locked(waited)),
            }
        }
        self.disable("it is damaged again and again")?;
        Ok(None)
    }

    fn locked(&self, waited: Duration) -> StoreError {
        StoreError::Locked {
            path: self.path.clone(),
            waited_ms: waited.as_millis() as u64,
        }
    }

    /// Runs a query on the tables in memory, or returns `None` if there are no such tables.
    fn in_memory<T>(&self, query: impl FnOnce(&Connection) -> rusqlite::Result<T>) -> Option<T> {
        query(self.memory.lock().as_ref()?).ok()
    }

    /// Runs a query on a connection to the file that has the name now.
    fn with_connection<T>(
        &self,
        slot: &Mutex<Option<Handle>>,
        query: impl FnOnce(&mut Connection) -> rusqlite::Result<T>,
    ) -> Result<T, Trouble> {
        let mut slot = slot.lock();
        let current = FileId::from_path(&self.path);
        slot.take_if(|handle| Some(handle.file) != current);
        let handle = match slot.as_mut() {
            Some(handle) => handle,
            None => slot.insert(self.connect()?),
        };
        Ok(query(&mut handle.connection)?)
    }

    /// Opens the file. Creates it if it is absent and the store can be written.
    fn connect(&self) -> Result<Handle, Trouble> {
        if self.access == Access::ReadOnly {
            return if self.path.exists() {
                Handle::open_immutable(&self.path)
            } else {
                Err(Trouble::Unusable("it is absent".to_owned()))
            };
        }
        let bytes = || self.files.meta(&self.path).map(|meta| meta.bytes);
        if bytes().is_some_and(|bytes| bytes > 0) {
            let _guard = self.guard(Share::Shared)?;
            return Handle::open(&self.path);
        }
        let _guard = self.guard(Share::Exclusive)?;
        match bytes() {
            Some(0) => Err(Trouble::Broken("it is empty".to_owned())),
            Some(_) => Handle::open(&self.path),
            None => self.create(),
        }
    }

    fn guard(&self, share: Share) -> Result<super::locks::Guard, Trouble> {
        let guard = self.locks.take(Lock::Index, share, &self.notices);
        guard.map_err(|error| match error {
            StoreError::Locked { .. } => Trouble::Busy,
            other => Trouble::Unusable(other.to_string()),
        })
    }

    /// Creates the file with all packs. The caller holds the lock of the index.
    fn create(&self) -> Result<Handle, Trouble> {
        for suffix in ["-wal", "-shm", "-journal"] {
            let removed = self.files.remove_file(&self.beside(suffix));
            removed.map_err(|error| Trouble::Unusable(error.to_string()))?;
        }
        let mut handle = Handle::create(&self.path)?;
        let synced = self.register(&mut handle.connection);
        if synced.is_err() {
            drop(handle);
            // Other processes must not take half an index for a whole one.
            let _ = self.files.remove_file(&self.path);
            synced?;
            return Err(Trouble::Busy);
        }
        Ok(handle)
    }

    /// Registers all packs that are on the disk and drops those that are not.
    fn register(&self, connection: &mut Connection) -> Result<(), Trouble> {
        let unusable = |error: StoreError| Trouble::Unusable(error.to_string());
        let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let mut registered = tables::packs(&transaction)?;
        let listed = self.listed().map_err(unusable)?;
        if registered.difference(&listed).next().is_some() {
            // Objects of a pack that is gone may be in another one too.
            tables::forget(&transaction, &registered)?;
            registered.clear();
        }
        for file in listed.difference(&registered) {
            if let Some(entries) = self.entries(file).map_err(unusable)? {
                tables::adopt(&transaction, file, &entries)?;
            }
        }
        Ok(transaction.commit()?)
    }

    /// Returns the entries of a pack, or `None` if the file is gone or not a pack. A file that is not a pack
    /// is moved to `bad/`.
    fn entries(&self, file: &str) -> Result<Option<Vec<Entry>>, StoreError> {
        let path = self.packs_dir().join(file);
        let Some(contents) = pack::contents(&self.files, &path)? else {
            return Ok(None);
        };
        if contents.has_table || !contents.entries.is_empty() {
            return Ok(Some(contents.entries));
        }
        if self.access == Access::ReadWrite {
            match self.files.quarantine(&self.root, &path, file) {
                Ok(to) => self.notices.warn(format!(
                    "a file that is not a pack was moved to `{}`",
                    to.display()
                )),
                // Another process has merged or collected it while it was read.
                Err(StoreError::Io { source, .. }) if source.kind() == ErrorKind::NotFound => {}
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }

    fn has_new_packs(&self) -> bool {
        let modified = self.files.meta(&self.packs_dir()).map(|meta| meta.modified);
        modified.is_none() || *self.seen.lock() != modified
    }

    /// Registers the packs that are not yet registered, in the file or else in memory. Returns whether there were any.
    pub(super) fn refresh(&self, patience: Duration) -> Result<bool, StoreError> {
        let modified = self.files.meta(&self.packs_dir()).map(|meta| meta.modified);
        let on_disk = self.read(tables::packs)?;
        let mut in_memory = self.in_memory(tables::packs).unwrap_or_default();
        let listed = self.listed()?;
        let is_settled = modified
            .and_then(|time| time.elapsed().ok())
            .is_some_and(|age| age > CLOCK_STEP);
        *self.seen.lock() = modified.filter(|_| is_settled);
        if on_disk.as_ref() == Some(&listed) {
            self.memory.lock().take();
            return Ok(false);
        }
        // Rows of a pack that is gone would hide those of the pack that replaced it.
        if !in_memory.is_subset(&listed) {
            self.memory.lock().take();
            in_memory.clear();
        }
        if self.access == Access::ReadOnly && on_disk.as_ref().is_some_and(|packs| !packs.is_subset(&listed))
        {
            self.disable("it names packs that are gone")?;
            return Ok(true);
        }
        let all = on_disk.is_some() && self.access == Access::ReadWrite;
        if all && self.write(patience, |connection| self.register(connection))? {
            self.memory.lock().take();
            return Ok(true);
        }
        let registered: BTreeSet<String> = on_disk.unwrap_or_default().union(&in_memory).cloned().collect();
        let mut added = false;
        for file in listed.difference(&registered) {
            if let Some(entries) = self.entries(file)? {
                self.remember(file, &entries);
                added = true;
            }
        }
        Ok(added)
    }

    /// Registers a pack in memory.
    fn remember(&self, file: &str, entries: &[Entry]) {
        let mut memory = self.memory.lock();
        if memory.is_none() {
            *memory = Connection::open_in_memory()
                .and_then(|connection| tables::create(&connection).map(|()| connection))
                .ok();
        }
        if let Some(connection) = memory.as_ref() {
            let _ = tables::adopt(connection, file, entries);
        }
    }

    /// Runs a change of the file. Returns whether it was made: it was not if another program keeps the file locked
    /// for longer than `patience`, or if the file cannot be written.
    fn write(
        &self,
        patience: Duration,
        change: impl Fn(&mut Connection) -> Result<(), Trouble>,
    ) -> Result<bool, StoreError> {
        for _ in 0..ATTEMPTS {
            if self.is_disabled.load(Ordering::Relaxed) {
                return Ok(false);
            }
            let mut trouble = None;
            let made = self.notices.retry(patience, || {
                let attempt = self.with_connection(&self.writer, |connection| Ok(change(connection)));
                match attempt.and_then(|made| made) {
                    Ok(()) => Ok(Some(true)),
                    Err(Trouble::Busy) => Ok(None),
                    Err(other) => {
                        trouble = Some(other);
                        Ok::<_, StoreError>(Some(false))
                    }
                }
            })?;
            match (made, trouble) {
                (Ok(true), _) => return Ok(true),
                (_, Some(Trouble::Broken(message))) => self.rebuild(&message)?,
                (_, Some(Trouble::Unusable(message))) => {
                    self.notices.warn_once("index", || {
                        format!(
                            "the index `{}` cannot be written ({message}) and is brought up to date later",
                            self.path.display()
                        )
                    });
                    return Ok(false);
                }
                _ => return Ok(false),
            }
        }
        Ok(false)
    }

    /// Registers a new pack. Where the file is locked the rows stay in memory, and whoever can next adds them to the
    /// file.
    pub(super) fn add(&self, file: &str, entries: &[Entry]) -> Result<(), StoreError> {
        let is_behind = self.memory.lock().is_some();
        let added = self.write(self.patience(), |connection| {
            if is_behind {
                return self.register(connection);
            }
            let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            tables::adopt(&transaction, file, entries)?;
            Ok(transaction.commit()?)
        })?;
        if added {
            if is_behind {
                self.memory.lock().take();
            }
            return Ok(());
        }
        self.remember(file, entries);
        if !self.is_disabled.load(Ordering::Relaxed) {
            self.notices.warn_once("locked index", || {
                format!(
                    "another program keeps the index `{}` locked. Results are stored, and the index is brought up to \
                     date later",
                    self.path.display()
                )
            });
        }
        Ok(())
    }

    /// Calls `each` with all objects, sorted by id, then with those in memory.
    pub(super) fn for_each(&self, mut each: impl FnMut(ObjectRow)) -> Result<(), StoreError> {
        let each = std::cell::RefCell::new(&mut each);
        self.read(|connection| tables::for_each(connection, &mut |row| each.borrow_mut()(row)))?;
        self.in_memory(|connection| tables::for_each(connection, &mut |row| each.borrow_mut()(row)));
        Ok(())
    }

    /// Returns the ids of all objects of a kind, sorted.
    pub(super) fn ids(&self, kind: Kind) -> Result<Vec<Digest>, StoreError> {
        let mut ids = self
            .read(|connection| tables::ids(connection, kind))?
            .unwrap_or_default();
        if let Some(others) = self.in_memory(|connection| tables::ids(connection, kind)) {
            ids.extend(others);
            ids.sort_unstable();
            ids.dedup();
        }
        Ok(ids)
    }

    /// Returns the pack file and the base of each segment of the file.
    pub(super) fn segments(&self) -> Result<Vec<(i64, String, u64)>, StoreError> {
        Ok(self.read(tables::segments)?.unwrap_or_default())
    }
}

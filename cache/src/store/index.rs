//! The index: records and memos in one redb file, shared by several processes.
//!
//! redb lets one process write or several read. So the file is open only for the milliseconds of a lookup or a
//! commit: readers share its lock, a commit takes it alone, and none waits longer than [`LOCK_TIMEOUT`].

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use parking_lot::Mutex;
use redb::{
    Builder, Database, DatabaseError, ReadOnlyDatabase, ReadTransaction, ReadableDatabase, ReadableTable,
    ReadableTableMetadata, TableDefinition,
};

use super::{
    error::StoreError,
    record::{Conflict, Record},
};
use crate::Digest;

/// Longest wait for the file lock; a commit of 10,000 rows takes 0.3 s.
const LOCK_TIMEOUT: Duration = Duration::from_secs(15);
/// Pause between two attempts to open the file.
const RETRY_INTERVAL: Duration = Duration::from_millis(2);
/// Memory the database may use while it is open.
const CACHE_BYTES: usize = 16 << 20;

const RECORDS: TableDefinition<&[u8; 32], &[u8]> = TableDefinition::new("records");
const MEMOS: TableDefinition<&[u8; 32], &[u8; 32]> = TableDefinition::new("memos");

/// Records and memos by key.
pub(super) struct Index {
    path: PathBuf,
    lock_timeout: Duration,
    /// Held while a thread of this process has the file open, so that none waits for another's file lock.
    file_lock: Mutex<()>,
}

impl Index {
    /// Returns the index in the folder of a store; opens nothing.
    pub(super) fn new(root: &Path) -> Self {
        Self {
            path: root.join("index.redb"),
            lock_timeout: LOCK_TIMEOUT,
            file_lock: Mutex::default(),
        }
    }

    #[cfg(test)]
    pub(super) fn with_lock_timeout(root: &Path, lock_timeout: Duration) -> Self {
        Self {
            lock_timeout,
            ..Self::new(root)
        }
    }

    /// Returns the length of the file.
    pub(super) fn bytes(&self) -> u64 {
        std::fs::metadata(&self.path).map_or(0, |meta| meta.len())
    }

    /// Returns the record of a key.
    pub(super) fn record(&self, key: &Digest) -> Result<Option<Record>, StoreError> {
        let found = self.read(|reader| {
            let table = reader.open_table(RECORDS)?;
            let value = table.get(key.as_bytes())?;
            Ok(value.and_then(|value| Record::decode(value.value())))
        })?;
        Ok(found.flatten())
    }

    /// Returns the blob stored under a memo key.
    pub(super) fn memo(&self, key: &Digest) -> Result<Option<Digest>, StoreError> {
        let found = self.read(|reader| {
            let table = reader.open_table(MEMOS)?;
            let value = table.get(key.as_bytes())?;
            Ok(value.map(|value| Digest::from_bytes(*value.value())))
        })?;
        Ok(found.flatten())
    }

    /// Returns all records, sorted by key.
    pub(super) fn records(&self) -> Result<Vec<Record>, StoreError> {
        let all = self.read(|reader| {
            let table = reader.open_table(RECORDS)?;
            let mut records = Vec::new();
            for row in table.iter()? {
                records.extend(Record::decode(row?.1.value()));
            }
            Ok(records)
        })?;
        Ok(all.unwrap_or_default())
    }

    /// Returns the number of records and of memos.
    pub(super) fn count(&self) -> Result<(u64, u64), StoreError> {
        let records = self.read(|reader| Ok(reader.open_table(RECORDS)?.len()?))?;
        let memos = self.read(|reader| Ok(reader.open_table(MEMOS)?.len()?))?;
        Ok((records.unwrap_or_default(), memos.unwrap_or_default()))
    }

    /// Writes records and memos in one transaction and returns the conflicts: results that came second for their
    /// key and differ.
    ///
    /// `has_outputs` tells whether all outputs of a record are in the store; a record without is replaced.
    pub(super) fn commit(
        &self,
        records: &BTreeMap<Digest, Record>,
        memos: &BTreeMap<Digest, Digest>,
        has_outputs: impl Fn(&Record) -> bool,
    ) -> Result<Vec<Conflict>, StoreError> {
        let _guard = self.file_lock.lock();
        self.create_if_absent()?;
        let database = self.open(|path| builder().create(path))?;
        write(&database, records, memos, has_outputs).map_err(|error| self.index_error(error))
    }

    /// Creates the file under a temporary name and links it to its own, so that it is never seen half-written.
    fn create_if_absent(&self) -> Result<(), StoreError> {
        if self.path.exists() {
            return Ok(());
        }
        let failed = |error| StoreError::io("make", &self.path)(error);
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let fresh = tempfile::Builder::new()
            .prefix("index.")
            .suffix(".new")
            .tempfile_in(folder);
        let fresh = fresh.map_err(failed)?;
        drop(
            builder()
                .create(fresh.path())
                .map_err(|error| self.index_error(error.into()))?,
        );
        match fresh.persist_noclobber(&self.path) {
            Err(error) if error.error.kind() != std::io::ErrorKind::AlreadyExists => Err(failed(error.error)),
            _ => Ok(()),
        }
    }

    /// Runs a query; none if the file or the table is absent.
    fn read<T>(
        &self,
        query: impl FnOnce(&ReadTransaction) -> Result<T, redb::Error>,
    ) -> Result<Option<T>, StoreError> {
        let _guard = self.file_lock.lock();
        if !self.path.exists() {
            return Ok(None);
        }
        let opened = match self.open(|path| match builder().open_read_only(path) {
            Err(DatabaseError::RepairAborted) => Ok(None),
            other => other.map(Some),
        })? {
            Some(database) => database,
            None => self.repair()?,
        };
        let answer = opened.begin_read().map_err(Into::into);
        match answer.and_then(|reader| query(&reader)) {
            Ok(answer) => Ok(Some(answer)),
            Err(redb::Error::TableDoesNotExist(_)) => Ok(None),
            Err(error) => Err(self.index_error(error)),
        }
    }

    /// Opens for writing, which rolls back the commit of a process that was killed, then for reading.
    fn repair(&self) -> Result<ReadOnlyDatabase, StoreError> {
        drop(self.open(|path| builder().open(path))?);
        self.open(|path| builder().open_read_only(path))
    }

    /// Opens the file, waiting for other processes up to the timeout.
    fn open<T>(&self, open: impl Fn(&Path) -> Result<T, DatabaseError>) -> Result<T, StoreError> {
        let began = Instant::now();
        loop {
            match open(&self.path) {
                Err(DatabaseError::DatabaseAlreadyOpen) if began.elapsed() < self.lock_timeout => {
                    std::thread::sleep(RETRY_INTERVAL);
                }
                Err(DatabaseError::DatabaseAlreadyOpen) => {
                    return Err(StoreError::Locked {
                        path: self.path.clone(),
                        waited_ms: began.elapsed().as_millis() as u64,
                    });
                }
                other => return other.map_err(|error| self.index_error(error.into())),
            }
        }
    }

    fn index_error(&self, error: redb::Error) -> StoreError {
        match error {
            redb::Error::Io(source) => StoreError::io("use", &self.path)(source),
            other => StoreError::Index {
                path: self.path.clone(),
                message: other.to_string(),
            },
        }
    }
}

fn builder() -> Builder {
    let mut builder = Builder::new();
    builder.set_cache_size(CACHE_BYTES);
    builder
}

fn write(
    database: &Database,
    records: &BTreeMap<Digest, Record>,
    memos: &BTreeMap<Digest, Digest>,
    has_outputs: impl Fn(&Record) -> bool,
) -> Result<Vec<Conflict>, redb::Error> {
    let writer = database.begin_write()?;
    let mut conflicts = Vec::new();
    {
        let mut table = writer.open_table(RECORDS)?;
        for record in records.values() {
            let present = table.get(record.key.as_bytes())?;
            let first = present.and_then(|value| Record::decode(value.value()));
            match first.filter(&has_outputs) {
                Some(first) if first.outputs != record.outputs => conflicts.push(conflict(first, record)),
                Some(_) => {}
                None => {
                    table.insert(record.key.as_bytes(), record.encode().as_slice())?;
                }
            }
        }
        let mut table = writer.open_table(MEMOS)?;
        for (key, blob) in memos {
            table.insert(key.as_bytes(), blob.as_bytes())?;
        }
    }
    writer.commit()?;
    Ok(conflicts)
}

fn conflict(first: Record, second: &Record) -> Conflict {
    Conflict {
        key: second.key,
        stage: second.stage.clone(),
        kept: first.outputs,
        refused: second.outputs.clone(),
    }
}

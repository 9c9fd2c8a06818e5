//! The access of a running stage to blobs, checkpoints and memos of the store, and a lease on its key.

use std::{
    collections::BTreeSet,
    fs::{self, File, TryLockError},
    io::Write,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use marf_cache::{
    Digest, Store,
    file::{self, FileKind, Links},
};
use marf_stage::{BlobError, Blobs, Cancel, Checkpoints, Keep, Memos, StageError};
use parking_lot::Mutex;

use crate::{
    errors::blob_error,
    event::{Event, Listener},
};

/// Pause between two attempts to take a lease.
const LEASE_RETRY_INTERVAL: Duration = Duration::from_millis(20);

/// The blobs of the store, for stages. It remembers every digest that was stored through it, for the closure of a record.
pub(crate) struct StoreBlobs<'a> {
    store: &'a Store,
    stored: Mutex<BTreeSet<Digest>>,
}

impl<'a> StoreBlobs<'a> {
    pub(crate) fn new(store: &'a Store) -> Self {
        Self {
            store,
            stored: Mutex::default(),
        }
    }

    /// Adds blobs that are needed though they were stored before.
    pub(crate) fn note(&self, needed: impl Iterator<Item = Digest>) {
        self.stored.lock().extend(needed);
    }

    /// Returns the digests stored so far, sorted, and forgets them.
    pub(crate) fn take_stored(&self) -> Vec<Digest> {
        std::mem::take(&mut *self.stored.lock()).into_iter().collect()
    }
}

impl Blobs for StoreBlobs<'_> {
    fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, BlobError> {
        self.store.get(digest).map_err(blob_error)
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        let digest = self.store.put(bytes).map_err(blob_error)?;
        self.stored.lock().insert(digest);
        Ok(digest)
    }

    fn put_file(&self, path: &Path, max_bytes: u64, keep: Keep) -> Result<(Digest, Arc<[u8]>), BlobError> {
        let stored = match keep {
            Keep::Copy => self.store.put_file(path, max_bytes),
            Keep::Reference => self.store.put_reference(path, max_bytes),
        };
        let (digest, bytes) = stored.map_err(blob_error)?;
        self.stored.lock().insert(digest);
        Ok((digest, bytes))
    }

    fn contains(&self, digest: &Digest) -> bool {
        self.store.contains(digest)
    }

    fn commit(&self) -> Result<(), BlobError> {
        self.store.commit().map_err(blob_error)
    }
}

/// The checkpoints of one key: a folder with a file for each part, each replaced atomically.
pub(crate) struct FileCheckpoints<'a> {
    dir: PathBuf,
    node: String,
    listener: &'a dyn Listener,
}

impl<'a> FileCheckpoints<'a> {
    pub(crate) fn new(store: &Store, key: &Digest, node: &str, listener: &'a dyn Listener) -> Self {
        Self {
            dir: store.checkpoints().join(key.to_string()),
            node: node.to_owned(),
            listener,
        }
    }

    /// Removes all parts.
    pub(crate) fn remove(&self) {
        let _ = fs::remove_dir_all(&self.dir);
    }

    fn path(&self, part: &str) -> PathBuf {
        self.dir.join(part)
    }

    /// Writes the digest of the state, then the state.
    fn write(&self, part: &str, state: &[u8]) -> std::io::Result<()> {
        fs::create_dir_all(&self.dir)?;
        let mut file = tempfile::Builder::new().suffix(".tmp").tempfile_in(&self.dir)?;
        file.write_all(Digest::from_content(state).as_bytes())?;
        file.write_all(state)?;
        file.as_file().sync_data()?;
        file.persist(self.path(part))?;
        Ok(())
    }
}

impl Checkpoints for FileCheckpoints<'_> {
    fn load(&self, part: &str) -> Option<Vec<u8>> {
        let bytes = file::read(&self.path(part), FileKind::State, Links::Refused).ok()?;
        let (checksum, state) = bytes.split_at_checked(32)?;
        (Digest::from_content(state).as_bytes() == checksum).then(|| state.to_vec())
    }

    fn save(&self, part: &str, state: &[u8]) {
        if let Err(error) = self.write(part, state) {
            self.listener.on_event(&Event::Warning {
                node: Some(self.node.clone()),
                message: format!(
                    "cannot keep the checkpoint `{}`: {error}",
                    self.path(part).display()
                ),
            });
        }
    }
}

/// Tables of partial results: blobs of the store under keys that the stage makes, kept as long as the key of the node that
/// made them.
pub(crate) struct StoreMemos<'a> {
    store: &'a Store,
    maker: Digest,
    node: String,
    listener: &'a dyn Listener,
}

impl<'a> StoreMemos<'a> {
    pub(crate) fn new(store: &'a Store, maker: Digest, node: &str, listener: &'a dyn Listener) -> Self {
        Self {
            store,
            maker,
            node: node.to_owned(),
            listener,
        }
    }
}

impl Memos for StoreMemos<'_> {
    fn load(&self, key: &Digest) -> Option<Arc<[u8]>> {
        load_memo(self.store, key)
    }

    /// Stores a table. It becomes durable with the next commit, at the latest when the run ends.
    fn save(&self, key: &Digest, table: &[u8]) {
        match self.store.put(table) {
            Ok(blob) => self.store.put_memo(*key, blob, self.maker),
            Err(error) => self.listener.on_event(&Event::Warning {
                node: Some(self.node.clone()),
                message: format!("cannot keep a table of partial results: {error}"),
            }),
        }
    }
}

/// Returns a table of partial results. None if it is missing, damaged or unreadable.
pub(crate) fn load_memo(store: &Store, key: &Digest) -> Option<Arc<[u8]>> {
    let blob = store.memo(key).ok()??;
    store.get(&blob).ok()
}

/// The exclusive right to run a key. A second process waits for it, and then finds the first one's result.
///
/// If files cannot be locked, two processes may do the same work with the same result.
pub(crate) struct Lease {
    path: PathBuf,
    _file: Option<File>,
}

impl Lease {
    /// Takes the lease on a key. Calls `on_wait` once if it must wait.
    ///
    /// # Errors
    /// A cancellation while it waits.
    pub(crate) fn take(
        dir: &Path,
        key: &Digest,
        cancel: &Cancel,
        on_wait: impl Fn(),
    ) -> Result<Self, StageError> {
        let path = dir.join("leases").join(key.to_string());
        let opened = fs::create_dir_all(dir.join("leases")).and_then(|()| File::create(&path));
        let Ok(file) = opened else {
            return Ok(Self { path, _file: None });
        };
        let mut has_waited = false;
        while matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
            if cancel.is_set() {
                return Err(StageError::Cancelled);
            }
            if !has_waited {
                on_wait();
                has_waited = true;
            }
            std::thread::sleep(LEASE_RETRY_INTERVAL);
        }
        let _file = Some(file);
        Ok(Self { path, _file })
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        // The lock is released when the file is closed, after this: a waiting process still gets it.
        let _ = fs::remove_file(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;
    use crate::SilentListener;

    #[test]
    fn a_checkpoint_comes_back_whole_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open(dir.path()).unwrap();
        let key = Digest::from_content(b"key");
        let checkpoints = FileCheckpoints::new(&store, &key, "train", &SilentListener);
        assert_eq!(checkpoints.load("training"), None);
        for state in [b"step 1".as_slice(), b"step 2, longer", b""] {
            checkpoints.save("training", state);
            assert_eq!(checkpoints.load("training").as_deref(), Some(state));
        }
        checkpoints.save("training", b"step 3");
        assert_eq!(checkpoints.load("trial-1"), None);
        let path = checkpoints.path("training");
        let mut bytes = fs::read(&path).unwrap();
        bytes[33] ^= 1;
        fs::write(&path, bytes).unwrap();
        assert_eq!(checkpoints.load("training"), None, "a damaged checkpoint is none");
        checkpoints.remove();
        assert!(!checkpoints.dir.exists());
    }

    #[test]
    fn a_table_of_partial_results_outlives_its_program_and_a_damaged_one_is_none() {
        let dir = tempfile::tempdir().unwrap();
        let key = Digest::from_content(b"features of photo 1, version 1");
        // Above 64 KiB a blob is a file of its own, which a test can damage.
        let table = vec![7_u8; 70_000];
        {
            let store = Store::open(dir.path()).unwrap();
            let memos = StoreMemos::new(
                &store,
                Digest::from_content(b"maker"),
                "calibrate",
                &SilentListener,
            );
            assert_eq!(memos.load(&key), None);
            memos.save(&key, b"old");
            memos.save(&key, &table);
            assert_eq!(memos.load(&key).as_deref(), Some(table.as_slice()));
            assert_eq!(memos.load(&Digest::from_content(b"another")), None);
            store.commit().unwrap();
        }
        let store = Store::open(dir.path()).unwrap();
        let memos = StoreMemos::new(
            &store,
            Digest::from_content(b"maker"),
            "calibrate",
            &SilentListener,
        );
        assert_eq!(memos.load(&key).as_deref(), Some(table.as_slice()));
        let hex = Digest::from_content(&table).to_string();
        fs::write(dir.path().join("cas").join(&hex[..2]).join(&hex[2..]), b"damaged").unwrap();
        assert_eq!(memos.load(&key), None);
        memos.save(&key, &table);
        assert_eq!(memos.load(&key).as_deref(), Some(table.as_slice()));
    }

    #[test]
    fn a_second_lease_on_a_key_waits_and_can_be_cancelled() {
        let dir = tempfile::tempdir().unwrap();
        let (key, cancel) = (Digest::from_content(b"key"), Cancel::default());
        let first = Lease::take(dir.path(), &key, &cancel, || {}).unwrap();
        let stop = || cancel.set();
        let cancelled = Lease::take(dir.path(), &key, &cancel, stop);
        assert!(matches!(cancelled, Err(StageError::Cancelled)));
        let other = Digest::from_content(b"other key");
        Lease::take(dir.path(), &other, &Cancel::default(), || panic!("it is free")).unwrap();

        let (waiting, released) = (AtomicBool::new(false), AtomicBool::new(false));
        std::thread::scope(|scope| {
            scope.spawn(|| {
                Lease::take(dir.path(), &key, &Cancel::default(), || {
                    waiting.store(true, Ordering::SeqCst)
                })
                .unwrap();
                assert!(released.load(Ordering::SeqCst), "it did not wait");
            });
            while !waiting.load(Ordering::SeqCst) {
                std::thread::yield_now();
            }
            released.store(true, Ordering::SeqCst);
            drop(first);
        });
    }
}

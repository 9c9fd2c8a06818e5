//! Temporary files: one folder for each open store, with a lock that its process holds until it ends.

use std::{
    fs::{File, TryLockError},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
    time::SystemTime,
};

use super::{error::StoreError, files::Files, locks::PATIENCE, notices::Notices};
use crate::Digest;

/// Lock file that keeps the creation of a folder and the removal of abandoned ones apart.
const GLOBAL_LOCK: &str = ".gate";
/// Lock file in each folder, held until the folder's process ends.
const OWNER_LOCK: &str = "alive";

static OPENED: AtomicU64 = AtomicU64::new(0);

/// The folder of temporary files of one open store, removed on drop.
pub(super) struct StagingDir {
    files: Files,
    dir: PathBuf,
    name: String,
    /// The lock is held as long as this is open.
    _owner_lock: File,
    counter: AtomicU64,
}

impl StagingDir {
    /// Creates a folder below `tmp`.
    pub(super) fn create(files: &Files, tmp: &Path, notices: &Notices) -> Result<Self, StoreError> {
        files.create_dir(tmp)?;
        let _global = notices
            .retry(PATIENCE, || global_lock(tmp))?
            .map_err(|waited| StoreError::Locked {
                path: tmp.join(GLOBAL_LOCK),
                waited_ms: waited.as_millis() as u64,
            })?;
        let name = unique_name();
        let dir = tmp.join(&name);
        files.create_dir(&dir)?;
        let path = dir.join(OWNER_LOCK);
        let owner_lock = File::create(&path).map_err(StoreError::io("create", &path))?;
        // On a file system without locks `sweep` removes nothing either.
        let _ = owner_lock.lock();
        Ok(Self {
            files: files.clone(),
            dir,
            name,
            _owner_lock: owner_lock,
            counter: AtomicU64::new(0),
        })
    }

    /// Returns a name that no other open store uses.
    pub(super) fn next_name(&self) -> String {
        format!(
            "{}-{:06}",
            self.name,
            self.counter.fetch_add(1, Ordering::Relaxed)
        )
    }

    /// Returns the path of a temporary file of this name.
    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.dir.join(name)
    }

    /// Returns the path of a new temporary file.
    pub(super) fn next_path(&self) -> PathBuf {
        self.path(&self.next_name())
    }
}

impl Drop for StagingDir {
    fn drop(&mut self) {
        let _ = self.files.remove_dir_all(&self.dir);
    }
}

/// Removes the folders of dead processes. Does nothing while another process holds the global lock.
pub(super) fn sweep(files: &Files, tmp: &Path) {
    let Ok(Some(_global)) = global_lock(tmp) else {
        return;
    };
    for name in files.names(tmp).unwrap_or_default() {
        let dir = tmp.join(&name);
        if dir.is_dir() && is_abandoned(&dir) {
            let _ = files.remove_dir_all(&dir);
        }
    }
}

/// Returns whether a folder's process has ended. Under the global lock no folder is being created, so one
/// without
/// an owner lock is abandoned too.
fn is_abandoned(dir: &Path) -> bool {
    match File::open(dir.join(OWNER_LOCK)) {
        Ok(owner) => owner.try_lock().is_ok(),
        Err(_) => true,
    }
}

/// Takes the global lock, or returns `None` if another process holds it.
fn global_lock(tmp: &Path) -> Result<Option<File>, StoreError> {
    let path = tmp.join(GLOBAL_LOCK);
    let file = File::create(&path).map_err(StoreError::io("create", &path))?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(error)) if error.kind() == std::io::ErrorKind::Unsupported => Ok(Some(file)),
        Err(TryLockError::Error(error)) => Err(StoreError::io("lock", &path)(error)),
    }
}

/// Returns 16 hexadecimal digits from the clock and the process id. They are in no result, only in names of
/// temporary files, packs and leases.
pub(super) fn unique_name() -> String {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let nanos = since.map_or(0, |since| since.as_nanos());
    let opened = OPENED.fetch_add(1, Ordering::Relaxed);
    let seed = format!("{} {nanos} {opened}", std::process::id());
    Digest::from_content(seed.as_bytes()).to_string()[..16].to_owned()
}

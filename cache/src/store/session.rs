//! Temporary files: one folder for each open store, with a lock that dies with its process.

use std::{
    fs::{self, File},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
    time::SystemTime,
};

use super::{StoreError, files};
use crate::Digest;

/// Locks the making of sessions against the sweeping of dead ones.
const GATE: &str = ".gate";
/// Held by the session's process as long as it lives.
const ALIVE: &str = "alive";

static OPENED: AtomicU64 = AtomicU64::new(0);

/// The folder of temporary files of one open store; goes with it.
pub(super) struct Session {
    dir: PathBuf,
    name: String,
    /// The lock is held as long as this is open.
    _alive: File,
    counter: AtomicU64,
}

impl Session {
    pub(super) fn begin(tmp: &Path) -> Result<Self, StoreError> {
        files::create_dir(tmp)?;
        let _gate = gate(tmp, File::lock)?;
        let name = unique_name();
        let dir = tmp.join(&name);
        files::create_dir(&dir)?;
        let path = dir.join(ALIVE);
        let alive = File::create(&path).map_err(StoreError::io("create", &path))?;
        // A file system without locks: nobody can sweep there either.
        let _ = alive.lock();
        Ok(Self {
            dir,
            name,
            _alive: alive,
            counter: AtomicU64::new(0),
        })
    }

    /// Returns a name that no other session uses.
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
}

impl Drop for Session {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.dir);
    }
}

/// Removes what dead processes left; leaves it for later if anybody is in the way.
pub(super) fn sweep(tmp: &Path) {
    let Ok(_gate) = gate(tmp, |file| file.try_lock().map_err(Into::into)) else {
        return;
    };
    for name in files::names(tmp).unwrap_or_default() {
        let dir = tmp.join(&name);
        if dir.is_dir() && is_dead(&dir) {
            let _ = fs::remove_dir_all(dir);
        }
    }
}

/// Nobody makes a session while we hold the gate, so one without its lock file is a torn one.
fn is_dead(dir: &Path) -> bool {
    match File::open(dir.join(ALIVE)) {
        Ok(alive) => alive.try_lock().is_ok(),
        Err(_) => true,
    }
}

fn gate(tmp: &Path, take: impl FnOnce(&File) -> std::io::Result<()>) -> Result<File, StoreError> {
    let path = tmp.join(GATE);
    let file = File::create(&path).map_err(StoreError::io("create", &path))?;
    match take(&file) {
        Err(error) if error.kind() == std::io::ErrorKind::Unsupported => Ok(file),
        other => other.map(|()| file).map_err(StoreError::io("lock", &path)),
    }
}

/// Names of sessions never reach a result; the clock and the process id only keep them apart.
fn unique_name() -> String {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let nanos = since.map_or(0, |since| since.as_nanos());
    let opened = OPENED.fetch_add(1, Ordering::Relaxed);
    let seed = format!("{} {nanos} {opened}", std::process::id());
    Digest::of(seed.as_bytes()).to_string()[..16].to_owned()
}

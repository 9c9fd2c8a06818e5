//! Files written so that a crash leaves the old or the new, never a half.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
};

use super::StoreError;

/// Most threads that wait for the disk at once: the journal takes their syncs together.
const SYNC_THREADS: usize = 8;

pub(super) fn create_dir(path: &Path) -> Result<(), StoreError> {
    fs::create_dir_all(path).map_err(StoreError::io("create folder", path))
}

/// Writes a new file that nobody may change afterwards.
pub(super) fn write_new(path: &Path, chunks: &[&[u8]]) -> Result<(), StoreError> {
    let write = || -> io::Result<()> {
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o444);
        let mut file = options.open(path)?;
        chunks.iter().try_for_each(|chunk| file.write_all(chunk))
    };
    write().map_err(|error| {
        // A half-written file is of no use to anybody.
        let _ = fs::remove_file(path);
        StoreError::io("write", path)(error)
    })
}

/// Brings files (their bytes) or folders (their entries) to the disk.
pub(super) fn sync(paths: &[PathBuf]) -> Result<(), StoreError> {
    let share = paths.len().div_ceil(SYNC_THREADS).max(1);
    if paths.len() == 1 {
        return sync_one(&paths[0]);
    }
    std::thread::scope(|scope| {
        let threads: Vec<_> = paths
            .chunks(share)
            .map(|part| scope.spawn(|| part.iter().try_for_each(|path| sync_one(path))))
            .collect();
        threads
            .into_iter()
            .try_for_each(|thread| thread.join().unwrap_or(Ok(())))
    })
}

fn sync_one(path: &Path) -> Result<(), StoreError> {
    let sync = || -> io::Result<()> {
        let file = File::open(path)?;
        if cfg!(unix) && file.metadata()?.is_dir() {
            return file.sync_all();
        }
        file.sync_data()
    };
    sync().map_err(StoreError::io("sync", path))
}

/// Gives a finished temporary file its name; what has the name already, stays.
///
/// Returns whether the name was free.
pub(super) fn publish(from: &Path, to: &Path) -> Result<Published, StoreError> {
    let outcome = match fs::hard_link(from, to) {
        Ok(()) => Published::New,
        Err(_) if to.exists() => Published::Present,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Err(StoreError::io("name", to)(error));
        }
        // A file system without hard links.
        Err(_) => return rename(from, to),
    };
    let _ = fs::remove_file(from);
    Ok(outcome)
}

/// Whether [`publish`] found its name free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Published {
    New,
    Present,
}

fn rename(from: &Path, to: &Path) -> Result<Published, StoreError> {
    fs::rename(from, to).map_err(StoreError::io("name", to))?;
    Ok(Published::New)
}

/// Returns the names of a folder's entries, sorted; an absent folder has none.
pub(super) fn names(dir: &Path) -> Result<Vec<String>, StoreError> {
    let entries = match fs::read_dir(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        other => other.map_err(StoreError::io("list", dir))?,
    };
    let mut names = Vec::new();
    for entry in entries {
        let entry = entry.map_err(StoreError::io("list", dir))?;
        names.extend(entry.file_name().into_string().ok());
    }
    names.sort_unstable();
    Ok(names)
}

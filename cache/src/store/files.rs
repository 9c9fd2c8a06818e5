//! File operations after which a crash leaves the old file or the new one, never a part of it.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
};

use super::error::StoreError;

/// Most threads that sync at once: the file system's journal then combines their syncs.
const SYNC_THREADS: usize = 8;

/// Creates a folder and its parents.
pub(super) fn create_dir(path: &Path) -> Result<(), StoreError> {
    fs::create_dir_all(path).map_err(StoreError::io("create folder", path))
}

/// Writes a new read-only file; on an error nothing is left of it.
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
        let _ = fs::remove_file(path);
        StoreError::io("write", path)(error)
    })
}

/// Flushes files (their bytes) and folders (their entries) to the disk.
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

/// Moves a finished temporary file to its final name. A file that has the name already stays, and the temporary
/// file is removed.
pub(super) fn publish(from: &Path, to: &Path) -> Result<Published, StoreError> {
    let outcome = link(from, to)?;
    let _ = fs::remove_file(from);
    Ok(outcome)
}

/// Gives a finished temporary file a second, final name, unless another file has that name.
///
/// On a file system without hard links the file is renamed.
pub(super) fn link(from: &Path, to: &Path) -> Result<Published, StoreError> {
    match fs::hard_link(from, to) {
        Ok(()) => Ok(Published::New),
        Err(_) if to.exists() => Ok(Published::Present),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(StoreError::io("name", to)(error)),
        Err(_) => fs::rename(from, to)
            .map(|()| Published::New)
            .map_err(StoreError::io("name", to)),
    }
}

/// Whether a final name was free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Published {
    /// It was free, and is the file's now.
    New,
    /// Another file has it.
    Present,
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

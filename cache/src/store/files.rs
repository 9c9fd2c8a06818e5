//! The file operations of the store: one layer, so that tests can fail any of them or lose what was not synced.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::Arc,
    time::SystemTime,
};

use super::error::StoreError;
use crate::file::{Links, is_irregular, open};

/// Whether a store can be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Access {
    ReadWrite,
    ReadOnly,
}

/// Most threads that sync at once: the file system's journal then combines their syncs.
const SYNC_THREADS: usize = 8;

/// Whether a final name was free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PublishResult {
    /// It was free, and is the file's now.
    New,
    /// Another file has it.
    Present,
}

/// Length, time of the last change, and place of the bytes of a file. For a link, the length of its target and its own
/// time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Meta {
    pub(super) bytes: u64,
    pub(super) modified: SystemTime,
    pub(super) place: Place,
}

/// Where the bytes of a file are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    /// In the file.
    Here,
    /// In another file, which it links to.
    Outside,
}

/// The operations of the operating system that the store needs.
pub(super) trait Operations: Send + Sync {
    /// Creates a folder and its parents.
    fn create_dir(&self, path: &Path) -> io::Result<()>;
    /// Writes a new read-only file.
    fn write_new(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;
    /// Appends to a file, and creates it if it is absent.
    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;
    /// Makes a copy of a file that shares its blocks. Returns an error if the file system cannot.
    fn reflink(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Makes a symbolic link to a file.
    fn reference(&self, target: &Path, link: &Path) -> io::Result<()>;
    /// Takes away the permission to write a file.
    fn seal(&self, path: &Path) -> io::Result<()>;
    /// Flushes the bytes of a file to the disk.
    fn sync_file(&self, path: &Path) -> io::Result<()>;
    /// Flushes the entries of a folder to the disk.
    fn sync_dir(&self, path: &Path) -> io::Result<()>;
    /// Gives a file a second name, unless another file has that name.
    fn link(&self, from: &Path, to: &Path) -> io::Result<PublishResult>;
    /// Moves a file. Replaces an existing file of the new name.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Removes a file.
    fn remove_file(&self, path: &Path) -> io::Result<()>;
    /// Removes a folder with all below it.
    fn remove_dir_all(&self, path: &Path) -> io::Result<()>;
    /// Reads a whole file.
    fn read(&self, path: &Path) -> io::Result<Vec<u8>>;
    /// Reads bytes of a file from an offset on, or fewer at its end.
    fn read_at(&self, path: &Path, offset: u64, len: usize) -> io::Result<Vec<u8>>;
    /// Returns the names of a folder's entries.
    fn names(&self, dir: &Path) -> io::Result<Vec<String>>;
    /// Returns length and time of a file or folder.
    fn meta(&self, path: &Path) -> io::Result<Meta>;
    /// Sets the time of the last change of a file.
    fn set_modified(&self, path: &Path, time: SystemTime) -> io::Result<()>;
}

/// The operating system.
pub(super) struct Disk;

impl Operations for Disk {
    fn create_dir(&self, path: &Path) -> io::Result<()> {
        fs::create_dir_all(path)
    }

    fn write_new(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o444);
        options.open(path)?.write_all(bytes)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let mut file = OpenOptions::new().append(true).create(true).open(path)?;
        file.write_all(bytes)
    }

    fn reflink(&self, from: &Path, to: &Path) -> io::Result<()> {
        reflink_copy::reflink(from, to)
    }

    fn reference(&self, target: &Path, link: &Path) -> io::Result<()> {
        let target = fs::canonicalize(target)?;
        #[cfg(unix)]
        return std::os::unix::fs::symlink(target, link);
        #[cfg(windows)]
        return std::os::windows::fs::symlink_file(target, link);
    }

    fn seal(&self, path: &Path) -> io::Result<()> {
        let mut permissions = fs::metadata(path)?.permissions();
        permissions.set_readonly(true);
        fs::set_permissions(path, permissions)
    }

    fn sync_file(&self, path: &Path) -> io::Result<()> {
        // Of a link only its name is ours.
        if path.is_symlink() {
            Ok(())
        } else {
            File::open(path)?.sync_data()
        }
    }

    fn sync_dir(&self, path: &Path) -> io::Result<()> {
        if cfg!(unix) {
            File::open(path)?.sync_all()
        } else {
            Ok(())
        }
    }

    fn link(&self, from: &Path, to: &Path) -> io::Result<PublishResult> {
        match fs::hard_link(from, to) {
            Ok(()) => Ok(PublishResult::New),
            Err(_) if to.exists() => Ok(PublishResult::Present),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Err(error),
            // A file system without hard links.
            Err(_) => fs::rename(from, to).map(|()| PublishResult::New),
        }
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn remove_dir_all(&self, path: &Path) -> io::Result<()> {
        fs::remove_dir_all(path)
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        open(path, Links::Followed)?.read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    fn read_at(&self, path: &Path, offset: u64, len: usize) -> io::Result<Vec<u8>> {
        let mut file = open(path, Links::Followed)?;
        // Some file systems refuse to seek far behind the end.
        if offset >= file.metadata()?.len() {
            return Ok(Vec::new());
        }
        file.seek(SeekFrom::Start(offset))?;
        let mut bytes = Vec::new();
        file.take(len as u64).read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    fn names(&self, dir: &Path) -> io::Result<Vec<String>> {
        let mut names = Vec::new();
        for entry in fs::read_dir(dir)? {
            names.extend(entry?.file_name().into_string().ok());
        }
        Ok(names)
    }

    fn meta(&self, path: &Path) -> io::Result<Meta> {
        let own = fs::symlink_metadata(path)?;
        let modified = own.modified().unwrap_or(SystemTime::UNIX_EPOCH);
        Ok(if own.is_symlink() {
            Meta {
                bytes: fs::metadata(path)?.len(),
                modified,
                place: Place::Outside,
            }
        } else {
            Meta {
                bytes: own.len(),
                modified,
                place: Place::Here,
            }
        })
    }

    fn set_modified(&self, path: &Path, time: SystemTime) -> io::Result<()> {
        File::open(path)?.set_modified(time)
    }
}

/// The layer, with errors that name operation and file.
#[derive(Clone)]
pub(super) struct Files(Arc<dyn Operations>);

impl Files {
    /// Returns the files of the operating system.
    pub(super) fn of_disk() -> Self {
        Self(Arc::new(Disk))
    }

    #[cfg(test)]
    pub(super) fn with_operations(operations: Arc<dyn Operations>) -> Self {
        Self(operations)
    }

    /// Creates a folder and its parents.
    pub(super) fn create_dir(&self, path: &Path) -> Result<(), StoreError> {
        self.0
            .create_dir(path)
            .map_err(StoreError::io("create folder", path))
    }

    /// Writes a new read-only file. After an error, nothing remains of it.
    pub(super) fn write_new(&self, path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
        self.0.write_new(path, bytes).map_err(|error| {
            let _ = self.0.remove_file(path);
            StoreError::io("write", path)(error)
        })
    }

    /// Appends to a file, and creates it if it is absent.
    pub(super) fn append(&self, path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
        self.0.append(path, bytes).map_err(StoreError::io("write", path))
    }

    /// Returns whether a copy that shares the blocks of a file could be made.
    pub(super) fn try_reflink(&self, from: &Path, to: &Path) -> bool {
        let linked = self.0.reflink(from, to).is_ok();
        if !linked {
            let _ = self.0.remove_file(to);
        }
        linked
    }

    /// Makes a symbolic link to a file.
    pub(super) fn reference(&self, target: &Path, link: &Path) -> Result<(), StoreError> {
        self.0
            .reference(target, link)
            .map_err(StoreError::io("link to", target))
    }

    /// Takes away the permission to write a file.
    pub(super) fn seal(&self, path: &Path) -> Result<(), StoreError> {
        self.0.seal(path).map_err(StoreError::io("seal", path))
    }

    /// Flushes the bytes of files to the disk.
    pub(super) fn sync_files(&self, paths: &[PathBuf]) -> Result<(), StoreError> {
        self.sync(paths, |path| self.0.sync_file(path))
    }

    /// Flushes the entries of folders to the disk.
    pub(super) fn sync_dirs(&self, paths: &[PathBuf]) -> Result<(), StoreError> {
        self.sync(paths, |path| self.0.sync_dir(path))
    }

    fn sync(
        &self,
        paths: &[PathBuf],
        sync: impl Fn(&Path) -> io::Result<()> + Sync,
    ) -> Result<(), StoreError> {
        let sync = |path: &PathBuf| sync(path).map_err(StoreError::io("sync", path));
        if paths.len() < 2 {
            return paths.iter().try_for_each(sync);
        }
        let share = paths.len().div_ceil(SYNC_THREADS);
        std::thread::scope(|scope| {
            let threads: Vec<_> = paths
                .chunks(share)
                .map(|part| scope.spawn(move || part.iter().try_for_each(sync)))
                .collect();
            threads
                .into_iter()
                .try_for_each(|thread| thread.join().unwrap_or(Ok(())))
        })
    }

    /// Moves a finished temporary file to its final name. A file that has the name already stays, and the temporary
    /// file is removed.
    pub(super) fn publish(&self, from: &Path, to: &Path) -> Result<PublishResult, StoreError> {
        let outcome = self.0.link(from, to).map_err(StoreError::io("name", to))?;
        let _ = self.0.remove_file(from);
        Ok(outcome)
    }

    /// Moves a file. Replaces an existing file of the new name.
    pub(super) fn rename(&self, from: &Path, to: &Path) -> Result<(), StoreError> {
        self.0.rename(from, to).map_err(StoreError::io("move", from))
    }

    /// Removes a file. An absent file is not an error.
    pub(super) fn remove_file(&self, path: &Path) -> Result<(), StoreError> {
        match self.0.remove_file(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            other => other.map_err(StoreError::io("remove", path)),
        }
    }

    /// Removes a folder with everything below it. An absent folder is not an error.
    pub(super) fn remove_dir_all(&self, path: &Path) -> Result<(), StoreError> {
        match self.0.remove_dir_all(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            other => other.map_err(StoreError::io("remove", path)),
        }
    }

    /// Reads a whole file, or returns `None` if it is absent. A pipe or a device is as damaged as an empty file: it is never read.
    pub(super) fn read(&self, path: &Path) -> Result<Option<Vec<u8>>, StoreError> {
        match self.0.read(path) {
            Err(error) if is_irregular(&error) => Ok(Some(Vec::new())),
            read => found(read, path),
        }
    }

    /// Reads bytes of a file from an offset on, fewer at its end. Returns `None` if the file is absent.
    pub(super) fn read_at(
        &self,
        path: &Path,
        offset: u64,
        len: usize,
    ) -> Result<Option<Vec<u8>>, StoreError> {
        found(self.0.read_at(path, offset, len), path)
    }

    /// Returns the names of a folder's entries, sorted. An absent folder has no entries.
    pub(super) fn names(&self, dir: &Path) -> Result<Vec<String>, StoreError> {
        let names = match self.0.names(dir) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            other => other.map_err(StoreError::io("list", dir))?,
        };
        let mut names = names;
        names.sort_unstable();
        Ok(names)
    }

    /// Returns whether a file or folder of this name exists.
    pub(super) fn exists(&self, path: &Path) -> Result<bool, StoreError> {
        Ok(found(self.0.meta(path), path)?.is_some())
    }

    /// Returns length and time of a file, or `None` if it is absent or they cannot be read.
    pub(super) fn meta(&self, path: &Path) -> Option<Meta> {
        self.0.meta(path).ok()
    }

    /// Sets the time of the last change of a file, where the file system can.
    pub(super) fn set_modified(&self, path: &Path, time: SystemTime) {
        let _ = self.0.set_modified(path, time);
    }

    /// Moves a file to `bad/` of a store under a free name, and returns its new path.
    pub(super) fn quarantine(&self, root: &Path, file: &Path, name: &str) -> Result<PathBuf, StoreError> {
        let to = self.free_place(root, name)?;
        self.rename(file, &to)?;
        Ok(to)
    }

    /// Returns a free path in `bad/` of a store.
    pub(super) fn free_place(&self, root: &Path, name: &str) -> Result<PathBuf, StoreError> {
        let folder = root.join("bad");
        self.create_dir(&folder)?;
        let plain = folder.join(name);
        let numbered = (1_u32..).map(|number| folder.join(format!("{name}.{number}")));
        let free = std::iter::once(plain.clone())
            .chain(numbered)
            .find(|path| !path.exists());
        Ok(free.unwrap_or(plain))
    }
}

fn found<T>(read: io::Result<T>, path: &Path) -> Result<Option<T>, StoreError> {
    match read {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(StoreError::io("read", path)(error)),
    }
}

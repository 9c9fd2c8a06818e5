//! Files that are replaced whole: a reader sees the old bytes or the new ones.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use marf_cache::Digest;
use marf_cache::file::{FileKind, Links, read, sync_folder};
use tempfile::TempPath;

/// End of the names of files that are not finished. They begin with a dot.
const UNFINISHED: &str = ".new";

/// Replaces a file. After a power cut it may be empty.
pub(crate) fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    Ok(unfinished(path, bytes)?.persist(path)?)
}

/// Files that are replaced together: after a power cut each holds its old bytes or its new ones.
#[derive(Default)]
pub(crate) struct Batch(Vec<(TempPath, PathBuf)>);

impl Batch {
    /// Writes the new bytes of a file next to it.
    pub fn add(&mut self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.0.push((unfinished(path, bytes)?, path.to_owned()));
        Ok(())
    }

    /// Replaces the old bytes by the new ones, once all are on the disk.
    pub fn finish(self) -> io::Result<()> {
        for (new, _) in &self.0 {
            // Opened for writing: some systems flush nothing through a handle that only reads.
            OpenOptions::new().append(true).open(new)?.sync_all()?;
        }
        let folders: BTreeSet<PathBuf> = self
            .0
            .iter()
            .filter_map(|(_, target)| Some(target.parent()?.to_owned()))
            .collect();
        for (new, target) in self.0 {
            new.persist(target)?;
        }
        folders.iter().try_for_each(|folder| sync_folder(folder))
    }
}

/// Returns the path with a suffix added to its name.
pub(crate) fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    PathBuf::from(name)
}

/// Removes what writers that died left unfinished in a folder. No writer may be at work there.
pub(crate) fn remove_unfinished(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
        if name.is_some_and(|name| name.starts_with('.') && name.ends_with(UNFINISHED)) {
            fs::remove_file(path)?;
        }
    }
    Ok(())
}

/// Reads a file that [`write_checked`] wrote. `None` if it is absent or damaged.
pub(crate) fn read_checked(path: &Path) -> Option<Vec<u8>> {
    let mut bytes = read(path, FileKind::State, Links::Followed).ok()?;
    let length = bytes.len().checked_sub(32)?;
    let whole = Digest::from_content(&bytes[..length]).as_bytes() == &bytes[length..];
    bytes.truncate(length);
    whole.then_some(bytes)
}

/// Writes a cache file, followed by the digest of its bytes. Its loss costs only time, so errors of writing are
/// ignored.
pub(crate) fn write_checked(path: &Path, mut bytes: Vec<u8>) {
    let digest = Digest::from_content(&bytes);
    bytes.extend_from_slice(digest.as_bytes());
    let folder = path.parent().map_or(Ok(()), fs::create_dir_all);
    drop(folder.and_then(|()| replace(path, &bytes)));
}

/// Writes bytes under a name of their own, in the folder of the file whose place they are to take. They are removed if they do
/// not.
fn unfinished(target: &Path, bytes: &[u8]) -> io::Result<TempPath> {
    let name = target.file_name().unwrap_or_default().to_string_lossy();
    let mut file = tempfile::Builder::new()
        .prefix(&format!(".{name}."))
        .suffix(UNFINISHED)
        // Not by `tempfile_in`: other people may read the file as the umask says.
        .make_in(target.parent().unwrap_or(target), |path| File::create_new(path))?;
    file.as_file_mut().write_all(bytes)?;
    // A batch may be of more files than a process may have open.
    Ok(file.into_temp_path())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_and_nothing_else_is_left() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.toml");
        replace(&path, b"one").unwrap();
        let mut batch = Batch::default();
        batch.add(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"one", "not before all are written");
        batch.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
        assert!(replace(&dir.path().join("absent/a"), b"x").is_err());
    }

    #[test]
    fn what_a_dead_writer_left_is_removed_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        for name in [".a.toml.1-0.new", "a.new", ".hidden"] {
            fs::write(dir.path().join(name), "x").unwrap();
        }
        remove_unfinished(dir.path()).unwrap();
        assert!(!dir.path().join(".a.toml.1-0.new").exists());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
    }

    #[test]
    fn a_checked_file_is_read_whole_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("new/table");
        for bytes in [b"".to_vec(), b"bytes".to_vec()] {
            write_checked(&path, bytes.clone());
            assert_eq!(read_checked(&path), Some(bytes));
        }
        let whole = fs::read(&path).unwrap();
        for index in 0..whole.len() {
            let mut flipped = whole.clone();
            flipped[index] ^= 1;
            fs::write(&path, &flipped).unwrap();
            assert_eq!(read_checked(&path), None, "byte {index}");
            fs::write(&path, &whole[..index]).unwrap();
            assert_eq!(read_checked(&path), None, "{index} bytes");
        }
    }
}

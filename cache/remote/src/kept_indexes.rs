//! Indexes of packs on the local disk, for programs that follow each other on one machine. An index never changes, and without a
//! copy each program would read the indexes of all packs again.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    process,
};

use marf_cache::Digest;
use marf_cache::file::{self, FileKind, Links};

/// A folder with indexes, a file each. What cannot be read or written there costs a request, never a result.
#[derive(Debug)]
pub(crate) struct KeptIndexes(PathBuf);

impl KeptIndexes {
    /// Returns the indexes of the shared store of this address, in a folder for those of all.
    pub(crate) fn new(folder: &Path, url: &str) -> Self {
        Self(folder.join(&Digest::from_content(url.as_bytes()).to_string()[..16]))
    }

    /// Returns the bytes of an index, possibly incomplete, or `None` if it does not exist.
    pub(crate) fn read(&self, pack: &Digest) -> Option<Vec<u8>> {
        file::read(&self.file(pack), FileKind::Document, Links::Followed).ok()
    }

    /// Keeps an index. Other programs see either the whole index or no index.
    pub(crate) fn keep(&self, pack: &Digest, bytes: &[u8]) {
        let (file, id) = (self.file(pack), process::id());
        let new = self.0.join(format!("{pack}.{id}.tmp"));
        let written = fs::create_dir_all(&self.0).and_then(|()| fs::write(&new, bytes));
        if written.and_then(|()| fs::rename(&new, file)).is_err() {
            let _ = fs::remove_file(new);
        }
    }

    /// Removes the indexes of packs that are there no more.
    pub(crate) fn prune(&self, packs: &BTreeSet<Digest>) {
        let Ok(files) = fs::read_dir(&self.0) else { return };
        for file in files.flatten() {
            let name = file.file_name();
            let pack = name.to_str().and_then(|name| name.parse::<Digest>().ok());
            if pack.is_some_and(|pack| !packs.contains(&pack)) {
                let _ = fs::remove_file(file.path());
            }
        }
    }

    fn file(&self, pack: &Digest) -> PathBuf {
        self.0.join(pack.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indexes_are_kept_by_store_until_their_packs_are_gone() {
        let dir = tempfile::tempdir().unwrap();
        let (kept, other) = (
            KeptIndexes::new(dir.path(), "s3://a"),
            KeptIndexes::new(dir.path(), "s3://b"),
        );
        let (first, second) = (Digest::from_content(b"1"), Digest::from_content(b"2"));
        assert_eq!(kept.read(&first), None);
        kept.prune(&BTreeSet::new());
        kept.keep(&first, b"one");
        kept.keep(&second, b"two");
        assert_eq!(kept.read(&first).as_deref(), Some(b"one".as_slice()));
        assert_eq!(other.read(&first), None);
        kept.prune(&BTreeSet::from([second]));
        assert_eq!(
            (kept.read(&first), kept.read(&second)),
            (None, Some(b"two".to_vec()))
        );
        // A folder that cannot be made keeps nothing, and that is not an error.
        let blocked = KeptIndexes(dir.path().join("file/below"));
        fs::write(dir.path().join("file"), b"").unwrap();
        blocked.keep(&first, b"one");
        assert_eq!(blocked.read(&first), None);
    }
}

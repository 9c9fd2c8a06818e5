//! What was written to a folder of outputs, so that files that have not changed since are not read again.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use marf_cache::{Digest, Store};
use serde::{Deserialize, Serialize};

use super::error::CliError;
use super::file_state::{FileState, state_of};
use super::files;

/// The files written below one folder, and the state in which they were left. It lies in the scratch folder of the store:
/// without it files are compared by their bytes.
pub struct ExportTable {
    out: PathBuf,
    path: PathBuf,
    entries: BTreeMap<PathBuf, Entry>,
    is_changed: bool,
}

/// What was written to a file or a folder, and what the file system said of it right afterwards.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Entry {
    digest: Digest,
    state: FileState,
}

impl ExportTable {
    /// Reads what was written below `out`; nothing is known of a folder that is new or whose table is damaged.
    pub fn load(store: &Store, out: &Path) -> Self {
        let whole = std::path::absolute(out).unwrap_or_else(|_| out.to_owned());
        let name = Digest::of(whole.as_os_str().as_encoded_bytes());
        let path = store.scratch().join("exports").join(format!("{name}.json"));
        let entries = std::fs::read(&path)
            .ok()
            .and_then(|bytes| serde_json::from_slice(&bytes).ok());
        Self {
            out: out.to_owned(),
            path,
            entries: entries.unwrap_or_default(),
            is_changed: false,
        }
    }

    /// Writes a file, unless it holds these bytes already.
    ///
    /// # Errors
    /// The error of `bytes`, or a place that cannot be written.
    pub fn write<E: From<CliError>>(
        &mut self,
        file: &Path,
        digest: &Digest,
        bytes: impl FnOnce() -> Result<Arc<[u8]>, E>,
    ) -> Result<(), E> {
        if self.has(file, digest) {
            return Ok(());
        }
        let path = self.out.join(file);
        let is_same = || std::fs::read(&path).is_ok_and(|there| Digest::of(&there) == *digest);
        if !is_same() {
            files::write(&path, &bytes()?)?;
        }
        self.note(file, digest);
        Ok(())
    }

    /// Tells whether a folder was written from this set, and no file of it was added or removed since.
    pub fn has_folder(&self, folder: &Path, root: &Digest) -> bool {
        self.has(folder, root)
    }

    /// Notes that all files of a folder are those of this set.
    pub fn note_folder(&mut self, folder: &Path, root: &Digest) {
        self.note(folder, root);
    }

    /// Removes the files of a folder that were written for it and are not among `files`.
    ///
    /// # Errors
    /// A file that cannot be removed.
    pub fn keep_only(&mut self, folder: &Path, files: &BTreeSet<PathBuf>) -> Result<(), CliError> {
        let is_old = |file: &&PathBuf| file.parent() == Some(folder) && !files.contains(*file);
        let old: Vec<PathBuf> = self.entries.keys().filter(is_old).cloned().collect();
        for file in old {
            files::remove(&self.out.join(&file))?;
            self.entries.remove(&file);
            self.is_changed = true;
        }
        Ok(())
    }

    fn has(&self, file: &Path, digest: &Digest) -> bool {
        let known = self.entries.get(file).filter(|entry| entry.digest == *digest);
        known.is_some_and(|entry| state_of(&self.out.join(file)) == Some(entry.state))
    }

    fn note(&mut self, file: &Path, digest: &Digest) {
        if let Some(state) = state_of(&self.out.join(file)) {
            let digest = *digest;
            self.entries.insert(file.to_owned(), Entry { digest, state });
            self.is_changed = true;
        }
    }

    /// Keeps the table; one that cannot be kept costs only time.
    pub fn save(&self) {
        if !self.is_changed {
            return;
        }
        if let Ok(json) = serde_json::to_vec(&self.entries) {
            let _ = files::write(&self.path, &json);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(table: &mut ExportTable, file: &str, text: &str) -> usize {
        let mut read = 0;
        let bytes = || {
            read += 1;
            Ok::<_, CliError>(Arc::from(text.as_bytes()))
        };
        table
            .write(Path::new(file), &Digest::of(text.as_bytes()), bytes)
            .unwrap();
        read
    }

    #[test]
    fn what_is_there_is_not_read_from_the_store_again_and_what_was_changed_or_removed_is() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open(dir.path().join("store")).unwrap();
        let out = dir.path().join("out");
        let mut table = ExportTable::load(&store, &out);
        assert_eq!(write(&mut table, "a/x.json", "one"), 1);
        table.save();
        let mut table = ExportTable::load(&store, &out);
        assert_eq!(write(&mut table, "a/x.json", "one"), 0);
        std::fs::write(out.join("a/x.json"), "edited").unwrap();
        assert_eq!(write(&mut table, "a/x.json", "one"), 1);
        std::fs::remove_dir_all(&out).unwrap();
        assert_eq!(write(&mut table, "a/x.json", "one"), 1);
        assert_eq!(std::fs::read_to_string(out.join("a/x.json")).unwrap(), "one");
    }

    #[test]
    fn a_folder_of_a_set_is_known_until_a_file_goes_and_loses_the_files_of_sols_that_are_gone() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open(dir.path().join("store")).unwrap();
        let mut table = ExportTable::load(&store, dir.path());
        let (folder, root) = (Path::new("v"), Digest::of(b"root"));
        write(&mut table, "v/1", "one");
        write(&mut table, "v/2", "two");
        table.note_folder(folder, &root);
        assert!(table.has_folder(folder, &root) && !table.has_folder(folder, &Digest::of(b"other")));
        table
            .keep_only(folder, &BTreeSet::from([PathBuf::from("v/2")]))
            .unwrap();
        assert!(!dir.path().join("v/1").exists() && dir.path().join("v/2").exists());
        assert!(!table.has_folder(folder, &root));
    }
}

//! What was written to a folder of outputs, so that files that have not changed since are not read again.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use marf_cache::file::{FileKind, Links, read};
use marf_cache::{Digest, Store};
use serde::{Deserialize, Serialize};

use crate::copies;
use crate::error::Error;
use crate::file_state::{FileState, state_of};
use crate::files;

/// The files written below one folder, and their state after writing. The table is in the scratch folder of the store. Without it, files
/// are compared by their bytes.
pub struct ExportTable {
    out: PathBuf,
    /// Root of the run that the files are of.
    run: Option<Digest>,
    /// Where the table is kept.
    file: PathBuf,
    /// What was written to files and folders, by path. While a set of verdicts is the same, its thousands of files are not looked at.
    entries: BTreeMap<PathBuf, Entry>,
    is_changed: bool,
}

/// The digest written to a file or a folder, and its file state right afterwards.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Entry {
    digest: Digest,
    state: FileState,
}

impl ExportTable {
    /// Returns the table of the files below `out`, which is empty for a folder that is new or whose table is damaged. New files are marked
    /// with the root `run` of their run, if their format has a place for it.
    pub fn load(store: &Store, out: &Path, run: Option<Digest>) -> Self {
        let whole = std::path::absolute(out).unwrap_or_else(|_| out.to_owned());
        let name = Digest::from_content(whole.as_os_str().as_encoded_bytes());
        let file = store.scratch().join("exports").join(format!("{name}.json"));
        let json = read(&file, FileKind::State, Links::Followed).ok();
        let entries = json.and_then(|json| serde_json::from_slice(&json).ok());
        Self {
            out: out.to_owned(),
            run,
            file,
            entries: entries.unwrap_or_default(),
            is_changed: false,
        }
    }

    /// Writes a file, unless it holds these bytes already.
    ///
    /// # Errors
    /// The error of `bytes`, or a place that cannot be written.
    pub fn write<E: From<Error>>(
        &mut self,
        file: &Path,
        digest: &Digest,
        bytes: impl FnOnce() -> Result<Arc<[u8]>, E>,
    ) -> Result<(), E> {
        if self.has(file, digest) {
            return Ok(());
        }
        let path = self.out.join(file);
        if !copies::is_copy(&path, digest) {
            files::write(&path, &copies::copy(&path, digest, &bytes()?, self.run))?;
        }
        self.note(file, digest);
        Ok(())
    }

    /// Removes the files of a folder that this table lists, that nobody has changed since, and that are not among `names`.
    ///
    /// # Errors
    /// A file that cannot be removed.
    pub fn keep_only(&mut self, folder: &Path, names: &BTreeSet<String>) -> Result<(), Error> {
        self.remove(folder, |name| !names.contains(name))
    }

    /// Removes the files of a folder that this table lists, that nobody has changed since, and whose name is `unwanted`.
    ///
    /// # Errors
    /// A file that cannot be removed.
    pub fn remove(&mut self, folder: &Path, unwanted: impl Fn(&str) -> bool) -> Result<(), Error> {
        let is_old = |file: &Path| {
            let name = file.file_name().and_then(|name| name.to_str());
            file.parent() == Some(folder) && name.is_some_and(&unwanted)
        };
        let listed = self.entries.keys().filter(|file| is_old(file));
        for file in listed.cloned().collect::<Vec<PathBuf>>() {
            let path = self.out.join(&file);
            if self.entries.get(&file).map(|entry| entry.state) == state_of(&path) {
                files::remove(&path)?;
            }
            self.entries.remove(&file);
            self.is_changed = true;
        }
        Ok(())
    }

    /// Returns whether these bytes were written to a file, and it has not changed since. Or whether a folder was written from this set, and no
    /// file of it was added or removed since.
    pub fn has(&self, path: &Path, digest: &Digest) -> bool {
        let known = self.entries.get(path).filter(|entry| entry.digest == *digest);
        known.is_some_and(|entry| Some(entry.state) == state_of(&self.out.join(path)))
    }

    /// Notes that a file has these bytes, or that all files of a folder are those of this set.
    pub fn note(&mut self, path: &Path, digest: &Digest) {
        if let Some(state) = state_of(&self.out.join(path)) {
            let digest = *digest;
            self.entries.insert(path.to_owned(), Entry { digest, state });
            self.is_changed = true;
        }
    }

    /// Stores the table. A table that cannot be stored only costs time.
    pub fn save(&self) {
        if self.is_changed
            && let Ok(json) = serde_json::to_vec(&self.entries)
        {
            let _ = files::write(&self.file, &json);
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
            Ok::<_, Error>(Arc::from(text.as_bytes()))
        };
        table
            .write(Path::new(file), &Digest::from_content(text.as_bytes()), bytes)
            .unwrap();
        read
    }

    #[test]
    fn what_is_there_is_not_read_from_the_store_again_and_what_was_changed_or_removed_is() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open(dir.path().join("store")).unwrap();
        let out = dir.path().join("out");
        let mut table = ExportTable::load(&store, &out, None);
        assert_eq!(write(&mut table, "a/x.json", "one"), 1);
        table.save();
        let mut table = ExportTable::load(&store, &out, None);
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
        let mut table = ExportTable::load(&store, dir.path(), None);
        let (folder, root) = (Path::new("v"), Digest::from_content(b"root"));
        write(&mut table, "v/1", "one");
        write(&mut table, "v/2", "two");
        table.note(folder, &root);
        assert!(table.has(folder, &root) && !table.has(folder, &Digest::from_content(b"other")));
        table
            .keep_only(folder, &BTreeSet::from(["2".to_owned()]))
            .unwrap();
        assert!(!dir.path().join("v/1").exists() && dir.path().join("v/2").exists());
        assert!(!table.has(folder, &root));
    }

    #[test]
    fn a_file_that_somebody_edited_stays() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open(dir.path().join("store")).unwrap();
        let mut table = ExportTable::load(&store, dir.path(), None);
        write(&mut table, "maps/old", "one");
        write(&mut table, "maps/edited", "two");
        std::fs::write(dir.path().join("maps/edited"), "longer than before").unwrap();
        table.keep_only(Path::new("maps"), &BTreeSet::new()).unwrap();
        assert!(!dir.path().join("maps/old").exists() && dir.path().join("maps/edited").exists());
    }
}

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
    /// Where the tables are kept.
    dir: PathBuf,
    /// Tables by folder, read on first use. While a set of verdicts is the same, its thousands of files are not looked at.
    tables: BTreeMap<PathBuf, FolderTable>,
}

/// What was written to the files and folders of one folder, by name.
#[derive(Debug, Default)]
struct FolderTable {
    entries: BTreeMap<String, Entry>,
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
        Self {
            out: out.to_owned(),
            run,
            dir: store.scratch().join("exports").join(name_of(&whole)),
            tables: BTreeMap::new(),
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

    /// Returns whether a folder was written from this set, and no file of it was added or removed since.
    pub fn has_folder(&mut self, folder: &Path, root: &Digest) -> bool {
        self.has(folder, root)
    }

    /// Notes that all files of a folder are those of this set.
    pub fn note_folder(&mut self, folder: &Path, root: &Digest) {
        self.note(folder, root);
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
        let path = self.out.join(folder);
        let table = self.table(folder);
        let old: Vec<(String, FileState)> = table
            .entries
            .iter()
            .filter(|(name, _)| unwanted(name))
            .map(|(name, entry)| (name.clone(), entry.state))
            .collect();
        for (name, state) in old {
            if state_of(&path.join(&name)) == Some(state) {
                files::remove(&path.join(&name))?;
            }
            table.entries.remove(&name);
            table.is_changed = true;
        }
        Ok(())
    }

    /// Returns the table of a folder, read at first use.
    fn table(&mut self, folder: &Path) -> &mut FolderTable {
        let read = || FolderTable::read(&table_path(&self.dir, folder));
        self.tables.entry(folder.to_owned()).or_insert_with(read)
    }

    fn has(&mut self, file: &Path, digest: &Digest) -> bool {
        let Some((folder, name)) = split(file) else {
            return false;
        };
        let known = self
            .table(folder)
            .entries
            .get(name)
            .filter(|entry| entry.digest == *digest);
        let state = known.map(|entry| entry.state);
        state.is_some() && state == state_of(&self.out.join(file))
    }

    fn note(&mut self, file: &Path, digest: &Digest) {
        if let Some((folder, name)) = split(file)
            && let Some(state) = state_of(&self.out.join(file))
        {
            let digest = *digest;
            let table = self.table(folder);
            table.entries.insert(name.to_owned(), Entry { digest, state });
            table.is_changed = true;
        }
    }

    /// Stores the tables. A table that cannot be stored only costs time.
    pub fn save(&self) {
        for (folder, table) in self.tables.iter().filter(|(_, table)| table.is_changed) {
            if let Ok(json) = serde_json::to_vec(&table.entries) {
                let _ = files::write(&table_path(&self.dir, folder), &json);
            }
        }
    }
}

impl FolderTable {
    /// Reads a table. A missing or damaged table is empty.
    fn read(path: &Path) -> Self {
        let json = read(path, FileKind::State, Links::Followed).ok();
        let entries = json.and_then(|json| serde_json::from_slice(&json).ok());
        Self {
            entries: entries.unwrap_or_default(),
            is_changed: false,
        }
    }
}

fn table_path(dir: &Path, folder: &Path) -> PathBuf {
    dir.join(format!("{}.json", name_of(folder)))
}

/// Returns the name of the folder for the tables of a path.
fn name_of(path: &Path) -> String {
    Digest::from_content(path.as_os_str().as_encoded_bytes()).to_string()
}

/// Returns the folder and the name of a file. None for a name that is not UTF-8.
fn split(file: &Path) -> Option<(&Path, &str)> {
    Some((file.parent()?, file.file_name()?.to_str()?))
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
        table.note_folder(folder, &root);
        assert!(
            table.has_folder(folder, &root) && !table.has_folder(folder, &Digest::from_content(b"other"))
        );
        table
            .keep_only(folder, &BTreeSet::from(["2".to_owned()]))
            .unwrap();
        assert!(!dir.path().join("v/1").exists() && dir.path().join("v/2").exists());
        assert!(!table.has_folder(folder, &root));
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

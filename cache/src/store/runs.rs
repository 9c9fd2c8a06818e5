//! Run roots: numbered files, one a run, written after everything they name. Their names hold their digests.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use serde::Deserialize;

use super::{
    Store,
    error::StoreError,
    files::{Access, Files},
    locks::{Lock, Share},
    record::Output,
};
use crate::Digest;

/// The file of a run's root.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RunFile {
    pub(super) number: u64,
    /// Digest of the bytes.
    digest: Digest,
    name: String,
}

impl RunFile {
    fn parse(name: &str) -> Option<Self> {
        let stem = name.strip_suffix(".json")?;
        let (number, digest) = stem.split_once('-')?;
        Some(Self {
            number: number.parse().ok()?,
            digest: digest.parse().ok()?,
            name: name.to_owned(),
        })
    }

    pub(super) fn path(&self, dir: &Path) -> PathBuf {
        dir.join(&self.name)
    }
}

/// Gives a finished temporary file of these bytes the next free number, durably, and returns the number. The caller has
/// the lock of the runs.
pub(super) fn publish(files: &Files, dir: &Path, file: &Path, bytes: &[u8]) -> Result<u64, StoreError> {
    // The number of a damaged run is not given again: pins and people name it.
    let quarantined = files.names(&dir.with_file_name("bad"))?;
    let quarantined = quarantined.iter().filter_map(|name| RunFile::parse(name));
    let taken = list(files, dir)?.into_iter().chain(quarantined);
    let number = taken.map(|run| run.number).max().unwrap_or(0) + 1;
    let name = format!("{number:06}-{}.json", Digest::from_content(bytes));
    files.publish(file, &dir.join(name))?;
    files.sync_dirs(&[dir.to_owned()])?;
    Ok(number)
}

/// Returns the files of all runs, oldest first.
pub(super) fn list(files: &Files, dir: &Path) -> Result<Vec<RunFile>, StoreError> {
    let names = files.names(dir)?;
    let mut runs: Vec<RunFile> = names.iter().filter_map(|name| RunFile::parse(name)).collect();
    runs.sort();
    Ok(runs)
}

/// Reads and verifies a run's root. Returns the path of its file if the bytes are damaged.
pub(super) fn read(files: &Files, dir: &Path, run: &RunFile) -> Result<Result<Vec<u8>, PathBuf>, StoreError> {
    let path = run.path(dir);
    let bytes = files
        .read(&path)?
        .ok_or(StoreError::NoRun { number: run.number })?;
    Ok(if Digest::from_content(&bytes) == run.digest {
        Ok(bytes)
    } else {
        Err(path)
    })
}

/// Returns the documents that a run root names, in addition to its keys. Roots of an earlier form name no
/// documents.
pub(super) fn documents(root: &[u8]) -> BTreeMap<String, Output> {
    #[derive(Default, Deserialize)]
    struct Named {
        #[serde(default)]
        documents: BTreeMap<String, Output>,
    }
    let named: Named = serde_json::from_slice(root).unwrap_or_default();
    named.documents
}

impl Store {
    /// Commits everything put so far, then stores a run's root under the next free number and returns the number.
    ///
    /// # Errors
    /// A store that cannot be written.
    pub fn put_run(&self, bytes: &[u8]) -> Result<u64, StoreError> {
        self.commit()?;
        let objects = &self.objects;
        let file = objects.staging()?.next_path();
        objects.files.write_new(&file, bytes)?;
        objects.files.sync_files(std::slice::from_ref(&file))?;
        let _guard = objects
            .locks
            .take(Lock::Runs, Share::Exclusive, &objects.notices)?;
        publish(&objects.files, &self.runs_dir(), &file, bytes)
    }

    /// Returns the numbers of all runs, oldest first.
    ///
    /// # Errors
    /// A folder that cannot be read.
    pub fn run_numbers(&self) -> Result<Vec<u64>, StoreError> {
        let runs = list(&self.objects.files, &self.runs_dir())?;
        let mut numbers: Vec<u64> = runs.into_iter().map(|run| run.number).collect();
        numbers.dedup();
        Ok(numbers)
    }

    /// Reads and verifies a run's root. A damaged one is an error of this number only.
    ///
    /// # Errors
    /// [`StoreError::NoRun`], or [`StoreError::DamagedRun`] once: a damaged root is quarantined.
    pub fn run(&self, number: u64) -> Result<Vec<u8>, StoreError> {
        let mut error = StoreError::NoRun { number };
        for run in self.runs_of(number)? {
            match read(&self.objects.files, &self.runs_dir(), &run)? {
                Ok(bytes) => return Ok(bytes),
                Err(path) => error = self.damaged_run(number, path)?,
            }
        }
        Err(error)
    }

    fn damaged_run(&self, number: u64, path: PathBuf) -> Result<StoreError, StoreError> {
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let path = match self.objects.access {
            Access::ReadWrite => self.objects.files.quarantine(&self.dir, &path, &name)?,
            Access::ReadOnly => path,
        };
        Ok(StoreError::DamagedRun { number, path })
    }

    fn runs_of(&self, number: u64) -> Result<Vec<RunFile>, StoreError> {
        let mut runs = list(&self.objects.files, &self.runs_dir())?;
        runs.retain(|run| run.number == number);
        Ok(runs)
    }

    /// Removes a run's root, if there is one.
    ///
    /// # Errors
    /// A file that cannot be removed.
    pub fn remove_run(&self, number: u64) -> Result<(), StoreError> {
        let files = self.runs_of(number)?;
        let mut files = files.iter().map(|run| run.path(&self.runs_dir()));
        files.try_for_each(|path| self.objects.files.remove_file(&path))
    }

    pub(super) fn runs_dir(&self) -> PathBuf {
        self.dir.join("runs")
    }
}

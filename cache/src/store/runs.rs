//! Run roots: numbered files, one a run, written after everything they name. Their names hold their digests.

use std::path::{Path, PathBuf};

use super::{error::StoreError, files::Files};
use crate::Digest;

/// The file of a run's root.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RunFile {
    pub(super) number: u64,
    /// Digest of the bytes; none in roots of 0.1.0.
    digest: Option<Digest>,
    name: String,
}

impl RunFile {
    fn parse(name: &str) -> Option<Self> {
        let stem = name.strip_suffix(".json")?;
        let (number, digest) = match stem.split_once('-') {
            Some((number, digest)) => (number, Some(digest.parse().ok()?)),
            None => (stem, None),
        };
        Some(Self {
            number: number.parse().ok()?,
            digest,
            name: name.to_owned(),
        })
    }

    pub(super) fn path(&self, dir: &Path) -> PathBuf {
        dir.join(&self.name)
    }

    /// Tells whether these are the bytes of the root.
    fn is_whole(&self, bytes: &[u8]) -> bool {
        match self.digest {
            Some(digest) => Digest::of(bytes) == digest,
            None => serde_json::from_slice::<serde::de::IgnoredAny>(bytes).is_ok(),
        }
    }
}

/// Gives a finished temporary file of these bytes the next free number, durably, and returns the number. The caller has
/// the lock of the runs.
pub(super) fn publish(files: &Files, dir: &Path, file: &Path, bytes: &[u8]) -> Result<u64, StoreError> {
    let number = list(files, dir)?.last().map_or(0, |run| run.number) + 1;
    let name = format!("{number:06}-{}.json", Digest::of(bytes));
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

/// Reads and verifies a run's root; the path of its file if the bytes are damaged.
pub(super) fn read(files: &Files, dir: &Path, run: &RunFile) -> Result<Result<Vec<u8>, PathBuf>, StoreError> {
    let path = run.path(dir);
    let bytes = files
        .read(&path)?
        .ok_or(StoreError::NoRun { number: run.number })?;
    Ok(match run.is_whole(&bytes) {
        true => Ok(bytes),
        false => Err(path),
    })
}

//! The files of a job, which the machines share.

use std::{
    fs,
    io::{Read as _, Seek as _, SeekFrom},
    path::{Path, PathBuf},
};

use marf_cache::Digest;
use marf_cache::file::{self, Links};

use crate::job_result::JobProgress;

/// Bytes at the end of a log that an error shows.
const LOG_TAIL_BYTES: u64 = 400;

/// The files of a job.
pub(crate) struct JobFiles {
    pub(crate) action: PathBuf,
    pub(crate) script: PathBuf,
    pub(crate) log: PathBuf,
    pub(crate) result: PathBuf,
    pub(crate) progress: PathBuf,
    pub(crate) scratch: PathBuf,
    /// Reported backend of a machine. It stays when the others are removed.
    pub(crate) backend: PathBuf,
}

impl JobFiles {
    pub(crate) fn new(folder: &Path, key: &Digest) -> Self {
        let file = |extension: &str| folder.join(format!("{key}{extension}"));
        Self {
            action: file(".action"),
            script: file(".sh"),
            log: file(".log"),
            result: file(".json"),
            progress: JobProgress::path(&file(".json")),
            scratch: file(""),
            backend: file(".backend"),
        }
    }

    /// Removes what a job with a result has left.
    pub(crate) fn remove(&self) {
        for file in [
            &self.action,
            &self.script,
            &self.log,
            &self.result,
            &self.progress,
        ] {
            let _ = fs::remove_file(file);
        }
        let _ = fs::remove_dir_all(&self.scratch);
    }

    /// Returns the end of the log, on one line.
    pub(crate) fn log_tail(&self) -> Option<String> {
        let mut log = file::open(&self.log, Links::Refused).ok()?;
        let length = log.metadata().ok()?.len().min(LOG_TAIL_BYTES);
        let mut tail = vec![0; length as usize];
        log.seek(SeekFrom::End(-(length as i64))).ok()?;
        log.read_exact(&mut tail).ok()?;
        let text = String::from_utf8_lossy(&tail);
        let lines: Vec<&str> = text
            .lines()
            .map(str::trim)
            .filter(|line| !line.is_empty())
            .collect();
        (!lines.is_empty()).then(|| lines.join("; "))
    }
}

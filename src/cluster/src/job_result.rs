//! The progress and the end of a job. A file each, written by rename.

use std::{
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use marf_cache::Digest;
use marf_cache::file::{self, FileKind, Links};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// How a job ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobResult {
    /// The key of its action.
    pub key: Digest,
    /// The program with its version.
    pub program: String,
    /// Why there is no result. Absent if there is a result, which then is in the shared store.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<Fault>,
    /// The backend of the machine of the job, if the question was for that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backend: Option<String>,
    /// What else the user should know, a sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
}

/// Why a job has no result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// What, where and how much, in one line.
    pub message: String,
    /// The cause, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cause: Option<String>,
    /// What to do about it, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hint: Option<String>,
    /// Another marf or another machine must make it.
    #[serde(default)]
    pub is_elsewhere: bool,
}

impl JobResult {
    /// Writes the file whole or not at all. Readers never see a part of it.
    ///
    /// # Errors
    /// Returns an error if the folder cannot be written.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        write_whole(path, self)
    }

    /// Reads the result of a key. Returns `None` if it is absent, incomplete or of another key.
    pub(crate) fn read(path: &Path, key: &Digest) -> Option<Self> {
        let result: Self = read_json(path)?;
        (result.key == *key).then_some(result)
    }
}

/// How far a job is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobProgress {
    /// Pieces of work done.
    pub done: u64,
    /// All of them.
    pub total: u64,
    /// What it is at.
    pub note: String,
}

impl JobProgress {
    /// Returns the path of the progress of a job, from the path of its result.
    pub fn path(result: &Path) -> PathBuf {
        result.with_extension("progress")
    }

    /// Replaces the file.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        write_whole(path, self)
    }

    /// Reads the progress of a job, or returns `None` if it has not reported any.
    pub(crate) fn read(path: &Path) -> Option<Self> {
        read_json(path)
    }
}

/// Reads JSON that a job wrote, or returns `None` if it is absent or incomplete.
fn read_json<T: DeserializeOwned>(path: &Path) -> Option<T> {
    let bytes = file::read(path, FileKind::Document, Links::Refused).ok()?;
    serde_json::from_slice(&bytes).ok()
}

/// Writes a file whole or not at all.
pub(crate) fn write_whole(path: &Path, content: &impl Serialize) -> io::Result<()> {
    let folder = path.parent().filter(|folder| *folder != Path::new(""));
    let folder = folder.unwrap_or(Path::new("."));
    fs::create_dir_all(folder)?;
    let mut file = tempfile::Builder::new().suffix(".tmp").tempfile_in(folder)?;
    serde_json::to_writer(&mut file, content)?;
    file.write_all(b"\n")?;
    file.as_file().sync_data()?;
    file.persist(path)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_lies_beside_the_result_and_is_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let path = JobProgress::path(&dir.path().join("ab.json"));
        assert!(path.ends_with("ab.progress"));
        assert_eq!(JobProgress::read(&path), None);
        for done in [1, 2] {
            let progress = JobProgress {
                done,
                total: 2,
                note: "loss".to_owned(),
            };
            progress.write(&path).unwrap();
            assert_eq!(JobProgress::read(&path), Some(progress));
        }
    }

    #[test]
    fn a_result_is_read_whole_and_for_its_own_key_alone() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("new/folder/result.json");
        let key = Digest::from_content(b"key");
        let result = JobResult {
            key,
            program: "marf 1".to_owned(),
            fault: Some(Fault {
                message: "out of paper".to_owned(),
                cause: None,
                hint: Some("buy some".to_owned()),
                is_elsewhere: false,
            }),
            backend: None,
            warnings: vec!["the toner is low".to_owned()],
        };
        assert_eq!(JobResult::read(&path, &key), None);
        result.write(&path).unwrap();
        assert_eq!(JobResult::read(&path, &key).as_ref(), Some(&result));
        assert_eq!(JobResult::read(&path, &Digest::from_content(b"other")), None);
        let whole = fs::read(&path).unwrap();
        for cut in [0, 1, whole.len() / 2, whole.len() - 3] {
            fs::write(&path, &whole[..cut]).unwrap();
            assert_eq!(JobResult::read(&path, &key), None, "{cut}");
        }
    }
}

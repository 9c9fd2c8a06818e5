//! The source of a run.

use std::{
    fmt,
    path::{Path, PathBuf},
};

use marf_cache::{Digest, Store};
use serde::{Deserialize, Serialize};

/// The source of a run.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum RunSource {
    /// A pipeline file. A pipeline is its file and its name ([`crate::RunRecord::pipeline`]).
    Pipeline {
        /// Path of the file from the folder that contains the store, with `/`. For a file elsewhere: 16 hexadecimal digits of the blake3 of
        /// its absolute path.
        file: String,
    },
    /// The pipeline that a verb builds for one folder of photos.
    Folder {
        /// The verb (`filter`, `calibrate`, `fit`).
        verb: String,
        /// The folder, as `file` of a pipeline.
        folder: String,
    },
    /// Results made from another run. They are attached to that run and are not runs of its pipeline.
    Derived {
        /// Root of that run. None if the pipeline has not run yet.
        from: Option<Digest>,
        /// Their purpose.
        purpose: Purpose,
    },
}

/// What results made from another run are for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Purpose {
    /// Files for other programs.
    Export,
    /// Pictures and films.
    Render,
    /// A point of a trade of time against quality.
    Trade,
    /// Changes between two times.
    Comparison,
    /// The list of scenes, found before the pipeline itself runs.
    Scenes,
}

impl Default for RunSource {
    fn default() -> Self {
        Self::Pipeline { file: String::new() }
    }
}

impl fmt::Display for Purpose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Export => "export",
            Self::Render => "render",
            Self::Trade => "trade",
            Self::Comparison => "comparison",
            Self::Scenes => "scenes",
        })
    }
}

impl RunSource {
    /// Returns the source of runs of a pipeline file.
    pub fn from_file(store: &Store, file: &Path) -> Self {
        Self::Pipeline {
            file: from_store(store, file),
        }
    }

    /// Returns the source of runs of a verb on one folder.
    pub fn from_folder(store: &Store, verb: &str, folder: &Path) -> Self {
        Self::Folder {
            verb: verb.to_owned(),
            folder: from_store(store, folder),
        }
    }

    /// Returns whether the run was made from another run.
    pub fn is_derived(&self) -> bool {
        matches!(self, Self::Derived { .. })
    }

    /// Returns the source by which runs are counted together: without the run that it was made from.
    #[must_use]
    pub fn series(&self) -> Self {
        match self {
            Self::Derived { purpose, .. } => Self::Derived {
                from: None,
                purpose: *purpose,
            },
            source => source.clone(),
        }
    }
}

/// Returns a path relative to the folder that contains a store. A path elsewhere becomes 16 digits, so that a record names no folder of a
/// machine.
fn from_store(store: &Store, path: &Path) -> String {
    let (path, store) = (absolute(path), absolute(store.dir()));
    let below = store.parent().and_then(|folder| path.strip_prefix(folder).ok());
    match below {
        None => Digest::from_content(path.as_os_str().as_encoded_bytes()).to_string()[..16].to_owned(),
        Some(below) if below.as_os_str().is_empty() => ".".to_owned(),
        Some(below) => {
            let parts: Vec<_> = below.iter().map(|part| part.to_string_lossy()).collect();
            parts.join("/")
        }
    }
}

/// Returns an absolute path without links, as far as it exists.
fn absolute(path: &Path) -> PathBuf {
    let resolved = path.canonicalize().or_else(|_| std::path::absolute(path));
    resolved.unwrap_or_else(|_| path.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_named_from_the_folder_of_the_store_and_others_by_digits() {
        let dir = tempfile::tempdir().unwrap();
        let project = dir.path().join("project");
        let store = Store::open(project.join(".marf")).unwrap();
        let file = |path: &Path| RunSource::from_file(&store, path);
        let named = |file: &str| RunSource::Pipeline {
            file: file.to_owned(),
        };
        assert_eq!(file(&project.join("pipeline.toml")), named("pipeline.toml"));
        assert_eq!(file(&project.join("a/b.toml")), named("a/b.toml"));
        let RunSource::Pipeline { file: elsewhere } = file(&dir.path().join("pipeline.toml")) else {
            unreachable!("a file is a pipeline");
        };
        assert_eq!(elsewhere.len(), 16);
        assert!(elsewhere.bytes().all(|digit| digit.is_ascii_hexdigit()));
        let folder = RunSource::Folder {
            verb: "filter".to_owned(),
            folder: ".".to_owned(),
        };
        assert_eq!(RunSource::from_folder(&store, "filter", &project), folder);
    }
}

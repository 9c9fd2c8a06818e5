//! Errors of exports.

use std::path::PathBuf;

use marf_engine::RecordError;
use marf_model::RunError;

/// Why a crate or a statement cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The bytes of a run root are none.
    #[error("the root of the run cannot be read: {0}")]
    BadRoot(#[from] RecordError),
    /// The store cannot be read, or has lost something of the run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The run did not end well.
    #[error("run `{id}` did not end with a result for every node ({outcome})")]
    Unfinished {
        /// Name of the run.
        id: String,
        /// Outcome of the run.
        outcome: String,
    },
    /// An object that the store does not give, or that is not what the run says.
    #[error("{0}")]
    Unreadable(String),
    /// A photo that the run did not look at.
    #[error("the run has no photo `{id}`")]
    UnknownItem {
        /// The requested name.
        id: String,
    },
    /// A node that the run does not have.
    #[error("the run has no node `{node}`")]
    UnknownNode {
        /// The requested name.
        node: String,
    },
    /// Something is where the crate shall go.
    #[error("{} is there already", path.display())]
    Exists {
        /// The place.
        path: PathBuf,
    },
    /// A file that cannot be written.
    #[error("cannot write {}: {cause}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        cause: std::io::Error,
    },
}

impl ExportError {
    /// Returns what the user can do about it, if anything.
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            Self::Unfinished { .. } => {
                Some("finish it with `marf run`, or choose a finished run from `marf log`")
            }
            Self::Unreadable(_) => Some("make lost results again with `marf run`, then export the new run"),
            Self::UnknownItem { .. } => Some("`marf photos` lists the names of all photos"),
            Self::UnknownNode { .. } => Some("`marf status` lists the nodes"),
            Self::Exists { .. } => Some("remove it, or name another folder"),
            Self::BadRoot(_) | Self::Run(_) | Self::Write { .. } => None,
        }
    }
}

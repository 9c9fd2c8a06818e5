//! Why a run cannot be read.

use marf_cache::{Digest, StoreError, manifest::ManifestError};
use marf_engine::EngineError;

/// Why a run, or an object that it leads to, cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The store cannot be read, or has lost an object.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The run root cannot be read.
    #[error(transparent)]
    Run(#[from] EngineError),
    /// An object is not what it should be.
    #[error("{what} cannot be read: {message}")]
    Malformed {
        /// The object.
        what: String,
        /// The error of the reader.
        message: String,
    },
    /// A record is not in the store.
    #[error("the record of {what} (key {}) is not in the store", key.short())]
    NoRecord {
        /// Whose record it is.
        what: String,
        /// Its key.
        key: Digest,
    },
}

impl RunError {
    /// Returns whether the error is a collected or lost object that the run needs.
    pub fn is_lost(&self) -> bool {
        match self {
            Self::Store(error) => error.lost().is_some(),
            Self::NoRecord { .. } => true,
            Self::Run(_) | Self::Malformed { .. } => false,
        }
    }
}

/// Returns the value, or `None` if the store has lost an object that it needs.
///
/// # Errors
/// Returns every other error.
pub fn unless_lost<T>(read: Result<T, RunError>) -> Result<Option<T>, RunError> {
    match read {
        Err(error) if error.is_lost() => Ok(None),
        read => read.map(Some),
    }
}

impl From<ManifestError> for RunError {
    fn from(error: ManifestError) -> Self {
        Self::Malformed {
            what: "a set".to_owned(),
            message: error.to_string(),
        }
    }
}

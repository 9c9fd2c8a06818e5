use marf_cache::Digest;

/// Why a node stopped.
#[derive(Debug, Clone, thiserror::Error)]
pub enum StageError {
    /// The user asked to stop. Everything that is already in the store stays.
    #[error("stopped")]
    Cancelled,
    /// The work cannot be done.
    #[error("{message}")]
    Failed {
        /// What, where and how much, in one line.
        message: String,
        /// The cause, if known.
        cause: Option<String>,
        /// The key to change or the command to run, if known.
        hint: Option<String>,
    },
    /// A blob could not be read or written.
    #[error(transparent)]
    Blob(#[from] BlobError),
}

impl StageError {
    /// Returns a failure with its one-line message.
    pub fn new(message: impl Into<String>) -> Self {
        Self::Failed {
            message: message.into(),
            cause: None,
            hint: None,
        }
    }

    /// Adds the cause.
    #[must_use]
    pub fn cause(mut self, text: impl Into<String>) -> Self {
        if let Self::Failed { cause, .. } = &mut self {
            *cause = Some(text.into());
        }
        self
    }

    /// Adds the key to change or the command to run.
    #[must_use]
    pub fn hint(mut self, text: impl Into<String>) -> Self {
        if let Self::Failed { hint, .. } = &mut self {
            *hint = Some(text.into());
        }
        self
    }
}

/// A blob that could not be read or written.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{message}")]
pub struct BlobError {
    /// Path, numbers and cause in one line.
    pub message: String,
    /// The blob that is missing or damaged, so that the node that produced it can run again.
    pub lost: Option<Digest>,
}

/// A parameter that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct ParamError {
    /// Dotted path of the key inside the node's table. Empty if it is the whole table.
    pub path: String,
    /// What is wrong, with the number.
    pub message: String,
}

impl ParamError {
    /// Returns the error of one key.
    pub fn new(path: impl Into<String>, message: impl Into<String>) -> Self {
        Self {
            path: path.into(),
            message: message.into(),
        }
    }
}

use crate::BlobError;

/// Why a node stopped.
#[derive(Debug, Clone, thiserror::Error)]
pub enum StageError {
    /// The user asked to stop; what was kept stays.
    #[error("stopped")]
    Cancelled,
    /// The work cannot be done.
    #[error("{message}")]
    Failed {
        /// What, where and how much, in one line.
        message: String,
        /// What lies behind it, if known.
        cause: Option<String>,
        /// The key to turn or the command to run, if known.
        hint: Option<String>,
    },
    /// The store did not give or take a blob.
    #[error(transparent)]
    Blob(#[from] BlobError),
}

impl StageError {
    /// A failure with its one-line message.
    pub fn new(message: impl Into<String>) -> Self {
        Self::Failed {
            message: message.into(),
            cause: None,
            hint: None,
        }
    }

    /// Adds what lies behind it.
    #[must_use]
    pub fn cause(mut self, text: impl Into<String>) -> Self {
        if let Self::Failed { cause, .. } = &mut self {
            *cause = Some(text.into());
        }
        self
    }

    /// Adds the way out.
    #[must_use]
    pub fn hint(mut self, text: impl Into<String>) -> Self {
        if let Self::Failed { hint, .. } = &mut self {
            *hint = Some(text.into());
        }
        self
    }
}

//! Why a request failed.

use marf_cache::StoreError;
use marf_cache::manifest::ManifestError;
use marf_config::LoadError;
use marf_engine::{EngineError, GraphError};
use marf_export::ExportError;
use marf_model::RunError;
use marf_remote::RemoteError;
use marf_stage::StageError;
use marf_view::ViewError;
use serde::Serialize;

/// Why a request failed, by what the user has to do about it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Error {
    /// A stage failed, or a result cannot be read or written.
    Failed(Diagnostic),
    /// A bad argument or pipeline.toml.
    Usage(Diagnostic),
    /// Something was made by a newer version.
    Newer(Diagnostic),
    /// Another marf or another machine must do it.
    Elsewhere(Diagnostic),
    /// Another process holds the store.
    Locked(Diagnostic),
    /// The request is answered, and the answer is not the one that the user hoped for.
    Answered(Answer, Diagnostic),
    /// The user has stopped it.
    Interrupted,
}

/// An answer about a file or a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// Made by a run, and as it was made.
    Whole,
    /// Not made by a run of the store.
    NotOurs,
    /// Altered, or made from something that was.
    Altered,
    /// Something of the lineage is not in the store any more.
    Incomplete,
    /// An archive has changed a product since, or is not as the readers expect.
    Changed,
    /// A replay gave something else.
    Differs,
    /// A replay could not compute every node again on this machine. The nodes that it computed are equal.
    NotMade,
    /// A replay of a run without any result, so that nothing was compared.
    NoResult,
    /// A crate or statement that is not signed with the given key.
    NotSigned,
}

/// The text of an error: message, cause, hint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostic {
    /// What, where and how much, in one line.
    pub message: String,
    /// The cause, if known.
    pub cause: Option<String>,
    /// What to do about it, if known.
    pub hint: Option<String>,
}

impl Diagnostic {
    /// Returns a text without cause or hint.
    pub fn new(message: impl Into<String>) -> Self {
        Self::with_hint(message, None)
    }

    /// Returns a text with a hint, if there is one.
    pub fn with_hint(message: impl Into<String>, hint: Option<String>) -> Self {
        Self {
            message: message.into(),
            cause: None,
            hint,
        }
    }

    /// Adds a hint.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }
}

impl Error {
    /// Returns a failure with a message alone.
    pub fn failed(message: impl Into<String>) -> Self {
        Self::Failed(Diagnostic::new(message))
    }

    /// Returns a usage error with a message alone.
    pub fn usage(message: impl Into<String>) -> Self {
        Self::Usage(Diagnostic::new(message))
    }

    /// Returns the error of something that is not as it was made.
    pub fn altered(diagnostic: Diagnostic) -> Self {
        Self::Answered(Answer::Altered, diagnostic)
    }

    /// Changes the hint, if there is one.
    #[must_use]
    pub fn map_hint(self, change: impl FnOnce(&str) -> String) -> Self {
        let changed = |diagnostic: Diagnostic| Diagnostic {
            hint: diagnostic.hint.as_deref().map(change),
            ..diagnostic
        };
        match self {
            Self::Failed(diagnostic) => Self::Failed(changed(diagnostic)),
            Self::Usage(diagnostic) => Self::Usage(changed(diagnostic)),
            other => other,
        }
    }

    /// Returns the text. None for a request that the user has stopped.
    pub fn diagnostic(&self) -> Option<&Diagnostic> {
        match self {
            Self::Failed(diagnostic)
            | Self::Usage(diagnostic)
            | Self::Newer(diagnostic)
            | Self::Elsewhere(diagnostic)
            | Self::Locked(diagnostic)
            | Self::Answered(_, diagnostic) => Some(diagnostic),
            Self::Interrupted => None,
        }
    }

    /// Returns the message alone.
    pub fn message(&self) -> &str {
        self.diagnostic()
            .map_or("stopped", |diagnostic| &diagnostic.message)
    }
}

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.message())
    }
}

impl std::error::Error for Error {}

impl From<LoadError> for Error {
    fn from(error: LoadError) -> Self {
        Self::Usage(Diagnostic::with_hint(error.message, error.hint))
    }
}

impl From<StoreError> for Error {
    fn from(error: StoreError) -> Self {
        let diagnostic = Diagnostic::with_hint(error.to_string(), error.hint());
        match error {
            StoreError::Stopped => Self::Interrupted,
            StoreError::Locked { .. } => {
                Self::Locked(diagnostic.hint("wait for the other run, or give this one its own --store"))
            }
            _ => Self::Failed(diagnostic),
        }
    }
}

impl From<ManifestError> for Error {
    fn from(error: ManifestError) -> Self {
        Self::failed(error.to_string())
    }
}

impl From<EngineError> for Error {
    fn from(error: EngineError) -> Self {
        match error {
            EngineError::Store(error) => error.into(),
            EngineError::Stopped => Self::Interrupted,
            EngineError::UnknownNode { .. } => Self::usage(error.to_string()),
            EngineError::BadRun { .. } | EngineError::BadSet(_) | EngineError::Threads { .. } => {
                Self::failed(error.to_string())
            }
        }
    }
}

impl From<RunError> for Error {
    fn from(error: RunError) -> Self {
        match error {
            RunError::Store(error) => error.into(),
            RunError::Run(error) => error.into(),
            error => Self::failed(error.to_string()),
        }
    }
}

impl From<StageError> for Error {
    fn from(error: StageError) -> Self {
        match error {
            StageError::Cancelled => Self::Interrupted,
            StageError::Failed { message, cause, hint } => Self::Failed(Diagnostic { message, cause, hint }),
            StageError::Blob(error) => Self::failed(error.message),
        }
    }
}

impl From<GraphError> for Error {
    fn from(error: GraphError) -> Self {
        Self::usage(error.to_string())
    }
}

impl From<ExportError> for Error {
    fn from(error: ExportError) -> Self {
        let diagnostic = Diagnostic::with_hint(error.to_string(), error.hint().map(str::to_owned));
        match error {
            ExportError::UnknownItem { .. }
            | ExportError::UnknownNode { .. }
            | ExportError::Exists { .. } => Self::Usage(diagnostic),
            _ => Self::Failed(diagnostic),
        }
    }
}

impl From<RemoteError> for Error {
    fn from(error: RemoteError) -> Self {
        let diagnostic = Diagnostic::with_hint(error.to_string(), error.hint());
        match error {
            RemoteError::Stopped => Self::Interrupted,
            RemoteError::Store(error) => error.into(),
            RemoteError::BadUrl { .. } | RemoteError::NoCredentials { .. } => Self::Usage(diagnostic),
            RemoteError::Newer { .. } => Self::Newer(diagnostic),
            RemoteError::Busy { .. } => Self::Locked(diagnostic),
            _ => Self::Failed(diagnostic),
        }
    }
}

impl From<ViewError> for Error {
    fn from(error: ViewError) -> Self {
        let diagnostic = Diagnostic::with_hint(error.to_string(), error.hint().map(str::to_owned));
        match error {
            ViewError::Access(_) | ViewError::Prefix(_) => Self::Usage(diagnostic),
            _ => Self::Failed(diagnostic),
        }
    }
}

use std::process::ExitCode;

use serde::Serialize;

use marf_config::LoadError;
use crate::terminal::escape_control;

/// Why a command failed; decides the exit code.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CliError {
    /// A stage failed, or a result cannot be read or written: exit code 1.
    Failed(Diagnostic),
    /// A bad command line or pipeline.toml: exit code 2.
    Usage(Diagnostic),
    /// Something was made by a newer version: exit code 8.
    Newer(Diagnostic),
    /// Another marf or another machine must do it: exit code 10.
    Elsewhere(Diagnostic),
    /// Another process holds the store: exit code 11.
    Locked(Diagnostic),
    /// The verb has answered, and the answer has an exit code of its own.
    Answered(Answer, Diagnostic),
    /// Ctrl-C: exit code 130.
    Interrupted,
}

/// An answer about a file or a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// Made by a run, and as it was made: exit code 0.
    Whole,
    /// Not made by a run of the store: exit code 3.
    NotOurs,
    /// Altered, or made from something that was: exit code 4.
    Altered,
    /// Something of the lineage is not in the store any more: exit code 5.
    Incomplete,
    /// An archive has changed a product since: exit code 6.
    Changed,
    /// A replay gave something else: exit code 7.
    Differs,
    /// A replay could not make everything again here, and what it made is equal: exit code 9.
    NotMade,
}

impl Answer {
    fn code(self) -> u8 {
        match self {
            Self::Whole => 0,
            Self::NotOurs => 3,
            Self::Altered => 4,
            Self::Incomplete => 5,
            Self::Changed => 6,
            Self::Differs => 7,
            Self::NotMade => 9,
        }
    }
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
        Self {
            message: message.into(),
            cause: None,
            hint: None,
        }
    }

    /// Adds a hint.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Returns `error: …`, `cause: …`, `hint: …` on a line each, with control characters escaped, so that no
    /// file name can drive the terminal.
    pub fn render(&self) -> String {
        let line = |label: &str, text: &Option<String>| {
            text.as_ref()
                .map(|text| format!("\n  {label}: {}", escape_control(text)))
                .unwrap_or_default()
        };
        format!(
            "error: {}{}{}",
            escape_control(&self.message),
            line("cause", &self.cause),
            line("hint", &self.hint)
        )
    }
}

impl CliError {
    /// Returns a failure with a message alone.
    pub fn failed(message: impl Into<String>) -> Self {
        Self::Failed(Diagnostic::new(message))
    }

    /// Returns a usage error with a message alone.
    pub fn usage(message: impl Into<String>) -> Self {
        Self::Usage(Diagnostic::new(message))
    }

    /// Returns the exit code: 1, 2, 8, 10, 11, 130, or that of an answer.
    pub fn code(&self) -> ExitCode {
        match self {
            Self::Failed(_) => ExitCode::from(1),
            Self::Usage(_) => ExitCode::from(2),
            Self::Newer(_) => ExitCode::from(8),
            Self::Elsewhere(_) => ExitCode::from(10),
            Self::Locked(_) => ExitCode::from(11),
            Self::Answered(answer, _) => ExitCode::from(answer.code()),
            Self::Interrupted => ExitCode::from(130),
        }
    }

    /// Returns the text; none after Ctrl-C.
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

    /// Returns what to print to stderr.
    pub fn render(&self) -> String {
        self.diagnostic().map_or_else(
            || "stopped; what was computed is kept, run again to go on".to_owned(),
            Diagnostic::render,
        )
    }
}

impl From<LoadError> for CliError {
    fn from(error: LoadError) -> Self {
        Self::Usage(Diagnostic {
            message: error.message,
            cause: None,
            hint: error.hint,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_diagnostic_has_its_three_lines_and_no_escape_codes() {
        let diagnostic = Diagnostic {
            message: "bad\u{1b}[2J".into(),
            cause: Some("c".into()),
            hint: Some("h".into()),
        };
        assert_eq!(diagnostic.render(), "error: bad\\u{1b}[2J\n  cause: c\n  hint: h");
    }
}

use std::process::ExitCode;

use crate::config::LoadError;

/// Why a command did not end well; decides the exit code.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CliError {
    /// A stage failed, or a result cannot be read or written: exit code 1.
    Failed(Complaint),
    /// A bad command line or pipeline.toml: exit code 2.
    Usage(Complaint),
    /// Another process holds the store: exit code 11.
    Locked(Complaint),
    /// Ctrl-C: exit code 130.
    Interrupted,
}

/// One error for people: what, what lies behind it, the way out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Complaint {
    /// What, where and how much, in one line.
    pub message: String,
    /// What lies behind it, if known.
    pub cause: Option<String>,
    /// The way out, if known.
    pub hint: Option<String>,
}

impl Complaint {
    /// A complaint without cause or hint.
    pub fn new(message: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            cause: None,
            hint: None,
        }
    }

    /// Adds the way out.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Returns `error: …`, `cause: …`, `hint: …` on a line each; control characters of foreign names are shown
    /// escaped, so that no file name can drive the terminal.
    pub fn render(&self) -> String {
        let line = |label: &str, text: &Option<String>| {
            text.as_ref()
                .map(|text| format!("\n  {label}: {}", printable(text)))
                .unwrap_or_default()
        };
        format!(
            "error: {}{}{}",
            printable(&self.message),
            line("cause", &self.cause),
            line("hint", &self.hint)
        )
    }
}

/// Escapes control characters but the line feed.
pub fn printable(text: &str) -> String {
    let escape = |char: char| {
        if char.is_control() && char != '\n' {
            char.escape_default().to_string()
        } else {
            char.into()
        }
    };
    text.chars().map(escape).collect()
}

impl CliError {
    /// A failure with its one line.
    pub fn failed(message: impl Into<String>) -> Self {
        Self::Failed(Complaint::new(message))
    }

    /// A misuse with its one line.
    pub fn usage(message: impl Into<String>) -> Self {
        Self::Usage(Complaint::new(message))
    }

    /// Returns the exit code of design section 10.
    pub fn code(&self) -> ExitCode {
        match self {
            Self::Failed(_) => ExitCode::from(1),
            Self::Usage(_) => ExitCode::from(2),
            Self::Locked(_) => ExitCode::from(11),
            Self::Interrupted => ExitCode::from(130),
        }
    }

    /// Returns what to print to stderr.
    pub fn render(&self) -> String {
        match self {
            Self::Failed(complaint) | Self::Usage(complaint) | Self::Locked(complaint) => complaint.render(),
            Self::Interrupted => "stopped; what was computed is kept, run again to go on".to_owned(),
        }
    }
}

impl From<LoadError> for CliError {
    fn from(error: LoadError) -> Self {
        Self::Usage(Complaint {
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
    fn a_complaint_has_its_three_lines_and_no_escape_codes() {
        let complaint = Complaint {
            message: "bad\u{1b}[2J".into(),
            cause: Some("c".into()),
            hint: Some("h".into()),
        };
        assert_eq!(complaint.render(), "error: bad\\u{1b}[2J\n  cause: c\n  hint: h");
    }
}

//! The terminal as the receiver of what happens while a request is worked on.

use std::sync::OnceLock;

use marf_engine::Event;
use marf_run::{Feedback, RunFeedback};

use super::progress::{JsonLines, for_stderr};
use crate::terminal::eprint_line;

/// Prints warnings, notes and progress.
pub struct Terminal {
    form: Form,
    /// Progress of a transfer, once one has begun.
    transfer: OnceLock<Box<dyn RunFeedback>>,
}

/// How progress is printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// Bars or lines on stderr.
    Text,
    /// Events of runs as JSON lines on stdout, nothing of transfers.
    JsonLines,
}

impl Terminal {
    /// Prints progress to stderr.
    pub fn with_progress() -> Self {
        Self {
            form: Form::Text,
            transfer: OnceLock::new(),
        }
    }

    /// Prints events of runs to stdout.
    pub fn with_json_lines() -> Self {
        Self {
            form: Form::JsonLines,
            transfer: OnceLock::new(),
        }
    }
}

impl Feedback for Terminal {
    fn warn(&self, message: &str) {
        eprint_line(&format!("warning: {message}"));
    }

    fn note(&self, line: &str) {
        eprint_line(line);
    }

    fn follow(&self, run: &str) -> Box<dyn RunFeedback> {
        match self.form {
            Form::Text => for_stderr(),
            Form::JsonLines => Box::new(JsonLines::new(run.to_owned())),
        }
    }

    fn on_transfer(&self, name: &str, moved: marf_remote::Progress) {
        if self.form == Form::JsonLines {
            return;
        }
        self.transfer.get_or_init(for_stderr).on_event(&Event::Progress {
            node: name.to_owned(),
            done: moved.done_bytes / 1_000,
            total: moved.total_bytes / 1_000,
            note: "KB".to_owned(),
        });
    }
}

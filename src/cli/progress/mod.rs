//! Prints the events of a run: bars on a terminal, plain lines elsewhere, JSON lines with `--json`.

mod bars;
mod json_lines;
mod lines;

use std::io::IsTerminal as _;

use marf_engine::{Event, Listener};
use marf_progress::RunProgress;
use marf_run::RunFeedback;

use bars::Bars;
pub use json_lines::JsonLines;
use lines::Lines;

use crate::terminal::eprint_line;

/// How the events of a run are printed.
pub enum Progress {
    /// One JSON object a line on stdout.
    Json(JsonLines),
    /// Bars and lines on stderr.
    Bars(Box<Bars>),
    /// Plain lines on stderr.
    Lines(Lines),
}

impl Progress {
    /// Returns bars if stderr is a terminal, plain lines otherwise.
    pub fn for_stderr() -> Self {
        if std::io::stderr().is_terminal() {
            Self::Bars(Box::default())
        } else {
            Self::Lines(Lines::default())
        }
    }
}

impl RunFeedback for Progress {
    fn on_devices(&self, devices: &str) {
        if !matches!(self, Self::Json(_)) {
            eprint_line(&format!("device  {devices}"));
        }
    }

    fn on_run_progress(&self, standing: &RunProgress) {
        match self {
            Self::Json(_) => {}
            Self::Bars(bars) => bars.on_run_progress(standing),
            Self::Lines(lines) => lines.on_run_progress(standing),
        }
    }
}

impl Listener for Progress {
    fn on_event(&self, event: &Event) {
        match self {
            Self::Json(lines) => lines.on_event(event),
            Self::Bars(bars) => bars.on_event(event),
            Self::Lines(lines) => lines.on_event(event),
        }
    }
}

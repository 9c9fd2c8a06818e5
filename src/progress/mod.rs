//! Prints the events of a run: bars on a terminal, plain lines elsewhere, JSON lines with `--json`.

mod bars;
mod lines;
mod text;

use std::io::IsTerminal as _;

use crate::terminal::print_line;
use marf_engine::{Event, Listener};

pub use bars::Bars;
pub use lines::Lines;
pub use text::duration;

/// How the events of a run are printed.
pub enum Progress {
    /// One JSON object a line on stdout.
    Json,
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

impl Listener for Progress {
    fn on_event(&self, event: &Event) {
        match self {
            Self::Json => {
                if let Ok(line) = serde_json::to_string(event) {
                    print_line(&line);
                }
            }
            Self::Bars(bars) => bars.on_event(event),
            Self::Lines(lines) => lines.on_event(event),
        }
    }
}

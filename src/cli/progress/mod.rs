//! Prints the events of a run: bars on a terminal, plain lines elsewhere, JSON lines with `--json`.

mod bars;
mod json_lines;
mod lines;

use std::io::IsTerminal as _;

use marf_run::RunFeedback;

use bars::Bars;
pub use json_lines::JsonLines;
use lines::Lines;

/// Returns bars if stderr is a terminal, plain lines otherwise.
pub fn for_stderr() -> Box<dyn RunFeedback> {
    if std::io::stderr().is_terminal() {
        Box::new(Bars::default())
    } else {
        Box::new(Lines::default())
    }
}

use marf_engine::{Event, Listener};
use marf_progress::Line;
use marf_run::RunFeedback;

use crate::terminal::print_document;

/// One JSON object a line on stdout: the event, its time, and the run it is of.
pub struct JsonLines {
    run: String,
}

impl JsonLines {
    /// Returns the printer of a run's events.
    pub fn new(run: String) -> Self {
        Self { run }
    }
}

impl RunFeedback for JsonLines {}

impl Listener for JsonLines {
    fn on_event(&self, event: &Event) {
        if let Ok(line) = serde_json::to_string(&Line::now(&self.run, event)) {
            print_document(&line);
        }
    }
}

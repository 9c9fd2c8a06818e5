use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use marf_engine::{Event, Listener};

use super::{duration, sentence};
use crate::cli::printable;

/// Between two progress lines of one node.
const EVERY: Duration = Duration::from_secs(10);

/// Plain lines, for logs: every event once, progress each ten seconds with what is left.
#[derive(Default)]
pub struct Lines {
    heard: Mutex<HashMap<String, (Instant, Instant)>>,
}

impl Lines {
    /// Returns since when a node has told of itself, if it is time for its next line.
    fn due(&self, node: &str) -> Option<Duration> {
        let now = Instant::now();
        let mut heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        let (first, last) = heard.entry(node.to_owned()).or_insert((now, now));
        (now - *last >= EVERY).then(|| {
            *last = now;
            now - *first
        })
    }
}

impl Listener for Lines {
    fn hear(&self, event: &Event) {
        if let Event::Progress {
            node,
            done,
            total,
            note,
        } = event
        {
            let Some(spent) = self.due(node) else { return };
            let left = spent.as_secs_f64() * (total.saturating_sub(*done) as f64) / (*done).max(1) as f64;
            let left = duration(left);
            crate::talk(&printable(&format!(
                "at      {node:<22} {done}/{total}, {left} left  {note}"
            )));
        } else if let Some(line) = sentence(event) {
            crate::talk(&printable(&line));
        }
    }
}

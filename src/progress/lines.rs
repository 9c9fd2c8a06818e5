use std::collections::HashMap;
use std::time::{Duration, Instant};

use marf_engine::{Event, Listener};
use parking_lot::Mutex;

use super::{duration, sentence};
use crate::cli::printable;

/// Between two progress lines of one node.
const EVERY: Duration = Duration::from_secs(10);

/// Plain lines, for logs: every event once, progress each ten seconds with what is left.
#[derive(Default)]
pub struct Lines {
    heard: Mutex<HashMap<String, Heard>>,
}

/// What a node has told of one piece of its work.
#[derive(Clone, Copy)]
struct Heard {
    began: Instant,
    last: Instant,
    at_first: u64,
    total: u64,
}

impl Lines {
    /// Returns how long the node's work will still take, if it is time for its next line.
    /// Another total is another piece of work: the clock starts anew.
    fn due(&self, node: &str, done: u64, total: u64) -> Option<String> {
        let now = Instant::now();
        let mut heard = self.heard.lock();
        let fresh = Heard {
            began: now,
            last: now,
            at_first: done,
            total,
        };
        let heard = heard.entry(node.to_owned()).or_insert(fresh);
        if heard.total != total {
            *heard = fresh;
        }
        (now - heard.last >= EVERY).then(|| {
            heard.last = now;
            let spent = (now - heard.began).as_secs_f64();
            let (did, left) = (done.saturating_sub(heard.at_first), total.saturating_sub(done));
            if did == 0 {
                "?".to_owned()
            } else {
                duration(spent * left as f64 / did as f64)
            }
        })
    }
}

impl Listener for Lines {
    fn on_event(&self, event: &Event) {
        if let Event::Progress {
            node,
            done,
            total,
            note,
        } = event
        {
            let Some(left) = self.due(node, *done, *total) else {
                return;
            };
            crate::talk(&printable(&format!(
                "at      {node:<22} {done}/{total}, {left} left  {note}"
            )));
        } else if let Some(line) = sentence(event) {
            crate::talk(&printable(&line));
        }
    }
}

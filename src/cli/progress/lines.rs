use std::collections::HashMap;
use std::time::{Duration, Instant};

use marf_engine::{Event, Listener};
use marf_progress::format::duration;
use marf_progress::{RunProgress, sentence};
use marf_run::RunFeedback;
use parking_lot::Mutex;

use crate::terminal::eprint_line;

/// Least time between two progress lines of one node.
const EVERY: Duration = Duration::from_secs(10);

/// Plain lines, for logs: one an event, and one each ten seconds for a node's progress and remaining time.
#[derive(Default)]
pub struct Lines {
    tracked: Mutex<HashMap<String, PieceOfWork>>,
    last_standing: Mutex<Option<Instant>>,
}

/// Progress of one piece of a node's work.
#[derive(Clone, Copy)]
struct PieceOfWork {
    began: Instant,
    last: Instant,
    at_first: u64,
    total: u64,
}

impl Lines {
    /// Returns the remaining time of the node's work, if its next line is due. Another total is another piece of work, whose time is
    /// measured from its own start.
    fn due(&self, node: &str, done: u64, total: u64) -> Option<String> {
        let now = Instant::now();
        let mut tracked = self.tracked.lock();
        let fresh = PieceOfWork {
            began: now,
            last: now,
            at_first: done,
            total,
        };
        let tracked = tracked.entry(node.to_owned()).or_insert(fresh);
        if tracked.total != total {
            *tracked = fresh;
        }
        (now - tracked.last >= EVERY).then(|| {
            tracked.last = now;
            let spent = (now - tracked.began).as_secs_f64();
            let (did, left) = (done.saturating_sub(tracked.at_first), total.saturating_sub(done));
            if did == 0 {
                "?".to_owned()
            } else {
                duration(spent * left as f64 / did as f64)
            }
        })
    }
}

impl RunFeedback for Lines {
    fn on_devices(&self, devices: &str) {
        eprint_line(&format!("device  {devices}"));
    }

    /// Prints how far the whole run is, every ten seconds, from ten seconds after its start.
    fn on_run_progress(&self, standing: &RunProgress) {
        let now = Instant::now();
        let mut last = self.last_standing.lock();
        if now - *last.get_or_insert(now) >= EVERY {
            *last = Some(now);
            eprint_line(&format!("run     {}", standing.text()));
        }
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
            let line = match total {
                0 => format!("at      {node:<22} {note}"),
                _ => format!("at      {node:<22} {done}/{total}, {left} left  {note}"),
            };
            eprint_line(&line);
        } else if let Some(line) = sentence(event) {
            eprint_line(&line);
        }
    }
}

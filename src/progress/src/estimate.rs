//! How far a whole run is, and how long the rest may take by what its nodes took last.

use std::collections::{BTreeMap, HashMap};
use std::time::{Duration, Instant};

use marf_engine::{Event, NodeState, RunRecord};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

use super::format::duration;

/// Shortest time between two standings.
const EVERY: Duration = Duration::from_secs(1);

/// What nodes took when they last ran.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeTimes {
    /// Wall time by node, seconds.
    seconds: BTreeMap<String, f64>,
    /// Mean number of nodes that ran at a time, at least 1.
    at_once: f64,
}

impl NodeTimes {
    /// Returns the times of earlier runs of a pipeline, given the newest first.
    pub fn from_runs<'r>(runs: impl Iterator<Item = &'r RunRecord>) -> Self {
        let mut seconds = BTreeMap::new();
        let mut at_once: Option<f64> = None;
        for run in runs {
            let ran = run
                .nodes
                .iter()
                .filter(|node| node.parent.is_none() && node.state == NodeState::Finished);
            let sum: f64 = ran.clone().map(|node| node.seconds).sum();
            if sum > 0.0 && run.seconds > 0.0 {
                at_once.get_or_insert((sum / run.seconds).max(1.0));
            }
            for node in ran {
                seconds.entry(node.name.clone()).or_insert(node.seconds);
            }
        }
        let at_once = at_once.unwrap_or(1.0);
        Self { seconds, at_once }
    }
}

/// How far a run is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunProgress {
    /// Seconds since its beginning.
    pub seconds: f64,
    /// Nodes that are over, whatever became of them.
    pub over: usize,
    /// All nodes, children aside.
    pub nodes: usize,
    /// Seconds that the nodes whose time is known may take yet.
    pub left_s: f64,
    /// Nodes without a known duration.
    pub unknown: usize,
}

impl RunProgress {
    /// Says it: `12 of 34 nodes, about 2 min 05 s left`.
    pub fn text(&self) -> String {
        let left = match (self.left_s > 0.0, self.unknown) {
            (false, 0) => String::new(),
            (true, 0) => format!(", about {} left", duration(self.left_s)),
            (false, unknown) => format!(", {unknown} of them with no known time"),
            (true, unknown) => format!(
                ", about {} left and {unknown} with no known time",
                duration(self.left_s)
            ),
        };
        format!("{} of {} nodes{left}", self.over, self.nodes)
    }
}

/// Follows the events of a run.
pub struct Estimate {
    began: Instant,
    expected: NodeTimes,
    state: Mutex<State>,
}

struct State {
    /// Nodes that are not over, children aside.
    open: HashMap<String, Option<NodeWork>>,
    nodes: usize,
    last: Option<Instant>,
}

/// A node that runs.
#[derive(Clone, Copy)]
struct NodeWork {
    began: Instant,
    /// The current piece of work: the time of its first report, and its units done then, done now and in total.
    piece: Option<(Instant, [u64; 3])>,
}

impl Estimate {
    /// Begins with nodes that have not ended.
    pub fn new(nodes: &[&str], expected: NodeTimes) -> Self {
        let open = nodes.iter().map(|name| ((*name).to_owned(), None)).collect();
        let state = State {
            open,
            nodes: nodes.len(),
            last: None,
        };
        Self {
            began: Instant::now(),
            expected,
            state: Mutex::new(state),
        }
    }

    /// Takes an event and returns the progress of the run, if a report is due.
    pub fn after(&self, event: &Event) -> Option<RunProgress> {
        let now = Instant::now();
        let mut state = self.state.lock();
        state.take(event, now);
        if state.last.is_some_and(|last| now - last < EVERY) {
            return None;
        }
        state.last = Some(now);
        Some(self.standing(&state, now))
    }

    fn standing(&self, state: &State, now: Instant) -> RunProgress {
        let left = |(name, running): (&String, &Option<NodeWork>)| {
            let known = self.expected.seconds.get(name).copied();
            running.map_or(known, |running| running.left_s(known, now))
        };
        let left: Vec<Option<f64>> = state.open.iter().map(left).collect();
        let known = || left.iter().flatten().copied();
        RunProgress {
            seconds: (now - self.began).as_secs_f64(),
            over: state.nodes - state.open.len(),
            nodes: state.nodes,
            // No run ends before its longest node.
            left_s: (known().sum::<f64>() / self.expected.at_once).max(known().fold(0.0, f64::max)),
            unknown: left.iter().filter(|left| left.is_none()).count(),
        }
    }
}

impl State {
    fn take(&mut self, event: &Event, now: Instant) {
        match event {
            Event::WillRun { node, .. } => {
                if let Some(open) = self.open.get_mut(node) {
                    *open = Some(NodeWork {
                        began: now,
                        piece: None,
                    });
                }
            }
            Event::Progress {
                node, done, total, ..
            } => {
                if let Some(Some(running)) = self.open.get_mut(node) {
                    running.at(*done, *total, now);
                }
            }
            Event::Reused { node, .. }
            | Event::Finished { node, .. }
            | Event::Failed { node, .. }
            | Event::Skipped { node, .. } => {
                self.open.remove(node);
            }
            Event::Warning { .. } => {}
        }
    }
}

impl NodeWork {
    fn at(&mut self, done: u64, total: u64, now: Instant) {
        self.piece = match self.piece {
            Some((since, [first, _, all])) if all == total => Some((since, [first, done, total])),
            _ => Some((now, [done, done, total])),
        };
    }

    /// Returns the seconds left: by the time it took last, and no less than its current piece of work needs. `None` for a node that
    /// never ran and has not reported anything.
    fn left_s(&self, known: Option<f64>, now: Instant) -> Option<f64> {
        let by_last = known.map(|seconds| (seconds - (now - self.began).as_secs_f64()).max(0.0));
        let by_piece = self.piece.and_then(|(since, [first, done, total])| {
            let did = done.checked_sub(first).filter(|did| *did > 0)?;
            Some((now - since).as_secs_f64() * total.saturating_sub(done) as f64 / did as f64)
        });
        match (by_last, by_piece) {
            (Some(last), Some(piece)) => Some(last.max(piece)),
            (last, piece) => last.or(piece),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expected(seconds: &[(&str, f64)], at_once: f64) -> NodeTimes {
        let seconds = seconds
            .iter()
            .map(|(name, seconds)| ((*name).to_owned(), *seconds));
        NodeTimes {
            seconds: seconds.collect(),
            at_once,
        }
    }

    fn reused(node: &str) -> Event {
        Event::Reused {
            node: node.to_owned(),
            reason: String::new(),
        }
    }

    #[test]
    fn the_rest_is_what_open_nodes_took_last_and_never_less_than_the_longest() {
        let estimate = Estimate::new(
            &["a", "b", "c", "d"],
            expected(&[("a", 5.0), ("b", 60.0), ("c", 20.0)], 2.0),
        );
        let standing = estimate.after(&reused("a")).unwrap();
        assert_eq!((standing.over, standing.nodes, standing.unknown), (1, 4, 1));
        assert_eq!(standing.left_s, 60.0, "the sum over two at once is 40");
        assert_eq!(
            standing.text(),
            "1 of 4 nodes, about 60 s left and 1 with no known time"
        );
        assert_eq!(estimate.after(&reused("b")), None, "told a moment ago");
    }

    #[test]
    fn a_child_is_no_node_of_the_run() {
        let estimate = Estimate::new(&["tune"], expected(&[], 1.0));
        let standing = estimate.after(&reused("tune/trial-00")).unwrap();
        assert_eq!((standing.over, standing.nodes), (0, 1));
        assert_eq!(standing.text(), "0 of 1 nodes, 1 of them with no known time");
    }

    #[test]
    fn a_running_node_is_as_long_as_it_was_or_as_its_piece_of_work_tells() {
        let now = Instant::now();
        let ago = |seconds| now.checked_sub(Duration::from_secs(seconds)).unwrap();
        let mut running = NodeWork {
            began: ago(30),
            piece: None,
        };
        assert_eq!(running.left_s(Some(40.0), now), Some(10.0));
        assert_eq!(running.left_s(Some(20.0), now), Some(0.0));
        assert_eq!(running.left_s(None, now), None);
        running.at(10, 100, ago(20));
        assert_eq!(running.left_s(None, now), None, "nothing is done of it yet");
        running.at(50, 100, now);
        assert_eq!(
            running.left_s(Some(40.0), now),
            Some(25.0),
            "40 in 20 s, 50 to go"
        );
        running.at(0, 7, now);
        assert_eq!(
            running.left_s(Some(40.0), now),
            Some(10.0),
            "another piece is measured from its start"
        );
    }
}

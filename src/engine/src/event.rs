//! Events: what runs, and why; one list for bars, JSON lines and tests.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use marf_cache::Output;
use marf_stage::Progress;
use parking_lot::Mutex;
use serde::Serialize;

/// Shortest time between two progress events of a node, but for its last.
const PROGRESS_PAUSE: Duration = Duration::from_millis(100);

/// Something that happened to a node. A child of an expanded node is named `parent/child`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// It begins to run.
    WillRun {
        /// The node.
        node: String,
        /// The first thing that changed since it last ran.
        reason: String,
        /// What it runs on: `cpu`, or adapter, driver and interface of a GPU.
        device: String,
    },
    /// Its result was in the store.
    Reused {
        /// The node.
        node: String,
        /// Where the result is from.
        reason: String,
    },
    /// How far it is; at most ten a second.
    Progress {
        /// The node.
        node: String,
        /// Units done.
        done: u64,
        /// Units in all.
        total: u64,
        /// A figure of the moment.
        note: String,
    },
    /// It ran to its end.
    Finished {
        /// The node.
        node: String,
        /// Time on the wall.
        seconds: f64,
        /// What came out, by name.
        outputs: BTreeMap<String, Output>,
        /// Figures: `photos` that came out, `rejected`, `measured`, `fetched`, `children`.
        counts: BTreeMap<String, u64>,
    },
    /// It failed.
    Failed {
        /// The node.
        node: String,
        /// What, where and how much.
        message: String,
        /// What lies behind it.
        cause: Option<String>,
        /// What to do about it.
        hint: Option<String>,
    },
    /// It did not run because something it needs is not there.
    Skipped {
        /// The node.
        node: String,
        /// What is not there.
        reason: String,
    },
    /// Something that is no failure but must be known.
    Warning {
        /// The node, if it is about one.
        node: Option<String>,
        /// One sentence.
        message: String,
    },
}

/// Hears events, from several threads.
pub trait Listener: Sync {
    /// Hears one event.
    fn on_event(&self, event: &Event);
}

/// Hears and forgets.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Listener for Silent {
    fn on_event(&self, _event: &Event) {}
}

/// Turns a stage's progress into events of its node, not too many.
pub(crate) struct NodeProgress<'a> {
    node: String,
    listener: &'a dyn Listener,
    last: Mutex<Option<Instant>>,
}

impl<'a> NodeProgress<'a> {
    pub(crate) fn new(node: &str, listener: &'a dyn Listener) -> Self {
        Self {
            node: node.to_owned(),
            listener,
            last: Mutex::new(None),
        }
    }

    fn is_due(&self) -> bool {
        let mut last = self.last.lock();
        let due = last.is_none_or(|last| last.elapsed() >= PROGRESS_PAUSE);
        if due {
            *last = Some(Instant::now());
        }
        due
    }
}

impl Progress for NodeProgress<'_> {
    fn at(&self, done: u64, total: u64, note: &str) {
        if done == total || self.is_due() {
            self.listener.on_event(&Event::Progress {
                node: self.node.clone(),
                done,
                total,
                note: note.to_owned(),
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[derive(Default)]
    struct Ears(Mutex<Vec<Event>>);

    impl Listener for Ears {
        fn on_event(&self, event: &Event) {
            self.0.lock().push(event.clone());
        }
    }

    #[test]
    fn the_json_forms_are_the_documented_ones() {
        let node = || "blur".to_owned();
        let reason = || "never ran".to_owned();
        let cases = [
            (
                Event::WillRun {
                    node: node(),
                    reason: reason(),
                    device: "cpu".to_owned(),
                },
                json!({"event": "will_run", "node": "blur", "reason": "never ran", "device": "cpu"}),
            ),
            (
                Event::Reused {
                    node: node(),
                    reason: reason(),
                },
                json!({"event": "reused", "node": "blur", "reason": "never ran"}),
            ),
            (
                Event::Skipped {
                    node: node(),
                    reason: reason(),
                },
                json!({"event": "skipped", "node": "blur", "reason": "never ran"}),
            ),
            (
                Event::Progress {
                    node: node(),
                    done: 1,
                    total: 3,
                    note: String::new(),
                },
                json!({"event": "progress", "node": "blur", "done": 1, "total": 3, "note": ""}),
            ),
            (
                Event::Failed {
                    node: node(),
                    message: "no".to_owned(),
                    cause: None,
                    hint: None,
                },
                json!({"event": "failed", "node": "blur", "message": "no", "cause": null, "hint": null}),
            ),
        ];
        for (event, expected) in cases {
            assert_eq!(serde_json::to_value(&event).unwrap(), expected);
        }
    }

    #[test]
    fn of_a_million_steps_the_first_and_the_last_are_told_and_few_between() {
        let ears = Ears::default();
        let progress = NodeProgress::new("train", &ears);
        let total = 1_000_000;
        (1..=total).for_each(|done| progress.at(done, total, ""));
        let heard = ears.0.into_inner();
        let done = |event: &Event| match event {
            Event::Progress { done, .. } => *done,
            _ => 0,
        };
        assert_eq!(heard.first().map(done), Some(1));
        assert_eq!(heard.last().map(done), Some(total));
        assert!(heard.len() < 1_000, "{}", heard.len());
    }
}

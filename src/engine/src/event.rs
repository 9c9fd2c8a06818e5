//! Events of a run: what happens to each node, for progress bars, JSON lines and tests.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use marf_cache::Output;
use marf_stage::Progress;
use parking_lot::Mutex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Shortest time between two progress events of a node, except the last one.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(100);

/// Something that happened to a node. A child of an expanded node is named `parent/child`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// It begins to run.
    WillRun {
        /// The node.
        node: String,
        /// The first difference from its last key.
        reason: String,
        /// Its device: `cpu`, or adapter, driver and interface of a GPU.
        device: String,
    },
    /// Its result was in the store.
    Reused {
        /// The node.
        node: String,
        /// Whether it is the result of the last run.
        reason: String,
    },
    /// Progress, at most ten events a second.
    Progress {
        /// The node.
        node: String,
        /// Units done.
        done: u64,
        /// Units in all.
        total: u64,
        /// A current figure, for people.
        note: String,
    },
    /// It ran to its end.
    Finished {
        /// The node.
        node: String,
        /// Wall time.
        seconds: f64,
        /// Output blobs by name: digest and bytes.
        #[schemars(with = "BTreeMap<String, OutputShape>")]
        outputs: BTreeMap<String, Output>,
        /// Figures: `photos` kept, `rejected`, `measured`, sols `fetched`, `summarised` (once a pass), `decided`, and `children`.
        counts: BTreeMap<String, u64>,
    },
    /// It failed.
    Failed {
        /// The node.
        node: String,
        /// What, where and how much.
        message: String,
        /// The underlying cause.
        cause: Option<String>,
        /// What to do about it.
        hint: Option<String>,
    },
    /// It did not run because an upstream node has no result, or the run was stopped.
    Skipped {
        /// The node.
        node: String,
        /// Which upstream node, or the stop.
        reason: String,
    },
    /// A warning.
    Warning {
        /// The node, if the warning is about one.
        node: Option<String>,
        /// One sentence.
        message: String,
    },
}

/// An output, for the schema alone.
#[derive(JsonSchema)]
#[allow(dead_code, reason = "only its schema is used")]
struct OutputShape {
    /// blake3, 64 hexadecimal digits.
    digest: String,
    /// Length.
    bytes: u64,
}

/// Receives events, from several threads.
pub trait Listener: Sync {
    /// Receives one event.
    fn on_event(&self, event: &Event);
}

/// Ignores all events.
#[derive(Debug, Clone, Copy, Default)]
pub struct SilentListener;

impl Listener for SilentListener {
    fn on_event(&self, _event: &Event) {}
}

/// Converts a stage's progress to events of its node, at a limited rate.
pub(crate) struct NodeProgress<'a> {
    node: String,
    listener: &'a dyn Listener,
    last: Mutex<Option<Instant>>,
    parts_s: Mutex<BTreeMap<String, f64>>,
}

impl<'a> NodeProgress<'a> {
    pub(crate) fn new(node: &str, listener: &'a dyn Listener) -> Self {
        Self {
            node: node.to_owned(),
            listener,
            last: Mutex::new(None),
            parts_s: Mutex::default(),
        }
    }

    /// Returns the seconds of parts of the work.
    pub(crate) fn parts_s(&self) -> BTreeMap<String, f64> {
        self.parts_s.lock().clone()
    }

    fn is_due(&self) -> bool {
        let mut last = self.last.lock();
        let due = last.is_none_or(|last| last.elapsed() >= PROGRESS_INTERVAL);
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

    fn warn(&self, message: &str) {
        self.listener.on_event(&Event::Warning {
            node: Some(self.node.clone()),
            message: message.to_owned(),
        });
    }

    fn took(&self, part: &'static str, seconds: f64) {
        *self.parts_s.lock().entry(part.to_owned()).or_default() += seconds;
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[derive(Default)]
    struct EventLog(Mutex<Vec<Event>>);

    impl Listener for EventLog {
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
    fn of_a_million_steps_the_first_the_last_and_few_between_are_events() {
        let log = EventLog::default();
        let progress = NodeProgress::new("train", &log);
        let total = 1_000_000;
        (1..=total).for_each(|done| progress.at(done, total, ""));
        let events = log.0.into_inner();
        let done = |event: &Event| match event {
            Event::Progress { done, .. } => *done,
            _ => 0,
        };
        assert_eq!(events.first().map(done), Some(1));
        assert_eq!(events.last().map(done), Some(total));
        assert!(events.len() < 1_000, "{}", events.len());
    }
}

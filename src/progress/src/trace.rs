use std::collections::HashMap;
use std::time::Instant;

use marf_engine::{Event, Listener};
use parking_lot::Mutex;
use serde_json::{Value, json};

/// Collects the events of a run as a trace for Perfetto and `chrome://tracing`: a bar for each node, below it bars for the
/// named parts of its progress, and a mark for each warning.
pub struct Trace {
    began: Instant,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    events: Vec<Value>,
    /// Lanes: the node that each is drawing, if any.
    lanes: Vec<Option<String>>,
    running: HashMap<String, DrawnNode>,
}

/// A node that is drawn at this moment.
struct DrawnNode {
    lane: usize,
    began_us: u64,
    reason: String,
    device: String,
}

impl Default for Trace {
    fn default() -> Self {
        Self {
            began: Instant::now(),
            state: Mutex::default(),
        }
    }
}

impl Trace {
    /// Returns the trace as JSON.
    pub fn json(&self) -> Value {
        let mut state = self.state.lock();
        let now = self.now_us();
        let open: Vec<String> = state.running.keys().cloned().collect();
        for node in open {
            state.end(&node, now, "stopped", json!({}));
        }
        json!({"displayTimeUnit": "ms", "traceEvents": state.events})
    }

    fn now_us(&self) -> u64 {
        u64::try_from(self.began.elapsed().as_micros()).unwrap_or(u64::MAX)
    }
}

impl State {
    /// Takes the first lane that draws nothing.
    fn begin(&mut self, node: &str, began_us: u64, reason: &str, device: &str) {
        let free = self.lanes.iter().position(Option::is_none);
        let lane = free.unwrap_or_else(|| {
            self.lanes.push(None);
            self.lanes.len() - 1
        });
        self.lanes[lane] = Some(node.to_owned());
        let running = DrawnNode {
            lane,
            began_us,
            reason: reason.to_owned(),
            device: device.to_owned(),
        };
        self.running.insert(node.to_owned(), running);
    }

    fn end(&mut self, node: &str, now_us: u64, outcome: &str, counts: Value) {
        let Some(running) = self.running.remove(node) else {
            return;
        };
        self.lanes[running.lane] = None;
        self.events.push(json!({
            "ph": "X", "pid": 1, "tid": running.lane + 1, "cat": "node", "name": node,
            "ts": running.began_us, "dur": now_us - running.began_us,
            "args": {"outcome": outcome, "reason": running.reason, "device": running.device, "counts": counts},
        }));
    }

    fn mark(&mut self, name: &str, now_us: u64, args: Value) {
        self.events.push(json!({
            "ph": "i", "s": "p", "pid": 1, "tid": 0, "cat": "mark", "name": name, "ts": now_us, "args": args,
        }));
    }
}

impl Listener for Trace {
    fn on_event(&self, event: &Event) {
        let now = self.now_us();
        let mut state = self.state.lock();
        match event {
            Event::WillRun { node, reason, device } => state.begin(node, now, reason, device),
            Event::Finished { node, counts, .. } => state.end(node, now, "finished", json!(counts)),
            Event::Failed { node, message, .. } => {
                state.end(node, now, "failed", json!({"message": message}))
            }
            Event::Skipped { node, reason } => {
                state.end(node, now, "stopped", json!({}));
                state.mark(&format!("skipped {node}"), now, json!({"reason": reason}));
            }
            Event::Reused { node, reason } => {
                state.mark(&format!("reused {node}"), now, json!({"reason": reason}));
            }
            Event::Warning { node, message } => {
                state.mark("warning", now, json!({"node": node, "message": message}));
            }
            Event::Progress {
                node, done, total, ..
            } => {
                let args = json!({"done": done, "total": total});
                state.events.push(json!({
                    "ph": "C", "pid": 1, "name": format!("progress of {node}"), "ts": now, "args": args,
                }));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn nodes_that_run_at_once_have_lanes_of_their_own_and_lanes_are_used_again() {
        let trace = Trace::default();
        let begin = |node: &str| {
            trace.on_event(&Event::WillRun {
                node: node.to_owned(),
                reason: "never ran".to_owned(),
                device: "cpu".to_owned(),
            });
        };
        let end = |node: &str| {
            trace.on_event(&Event::Finished {
                node: node.to_owned(),
                seconds: 0.1,
                outputs: BTreeMap::new(),
                counts: BTreeMap::new(),
            });
        };
        begin("a");
        begin("b");
        end("a");
        begin("c");
        end("c");
        let json = trace.json();
        let lane = |node: &str| {
            let events = json["traceEvents"].as_array().unwrap();
            let of = events.iter().find(|event| event["name"] == node).unwrap();
            (
                of["tid"].as_u64().unwrap(),
                of["args"]["outcome"].as_str().unwrap().to_owned(),
            )
        };
        assert_eq!(lane("a"), (1, "finished".to_owned()));
        assert_eq!(lane("c"), (1, "finished".to_owned()));
        assert_eq!(
            lane("b"),
            (2, "stopped".to_owned()),
            "what has not ended is drawn too"
        );
    }
}

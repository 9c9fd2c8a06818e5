//! A listener that keeps all events, and what tests read from it.

use marf_engine::{Event, Listener};
use parking_lot::Mutex;

/// Keeps all events.
#[derive(Default)]
pub struct EventLog(pub Mutex<Vec<Event>>);

impl Listener for EventLog {
    fn on_event(&self, event: &Event) {
        self.0.lock().push(event.clone());
    }
}

/// What node_events to each node, in the order it node_events: `ran`, `reused`, `failed`, `skipped`.
pub fn node_events(log: &EventLog) -> Vec<(String, String)> {
    let events = log.0.lock();
    let told = events.iter().filter_map(|event| match event {
        Event::Finished { node, .. } => Some((node.clone(), "ran".to_owned())),
        Event::Reused { node, .. } => Some((node.clone(), "reused".to_owned())),
        Event::Failed { node, message, .. } => Some((node.clone(), format!("failed: {message}"))),
        Event::Skipped { node, reason } => Some((node.clone(), format!("skipped: {reason}"))),
        _ => None,
    });
    told.collect()
}

/// The nodes that ran to their end, sorted.
pub fn ran(log: &EventLog) -> Vec<String> {
    let mut names: Vec<String> = node_events(log)
        .into_iter()
        .filter(|(_, what)| what == "ran")
        .map(|(node, _)| node)
        .collect();
    names.sort();
    names
}

/// Returns the reason for which a node ran.
pub fn reason_of(log: &EventLog, wanted: &str) -> Option<String> {
    let events = log.0.lock();
    events.iter().find_map(|event| match event {
        Event::WillRun { node, reason, .. } if node == wanted => Some(reason.clone()),
        _ => None,
    })
}

/// Returns all warnings.
pub fn warnings(log: &EventLog) -> Vec<String> {
    let events = log.0.lock();
    let warnings = events.iter().filter_map(|event| match event {
        Event::Warning { message, .. } => Some(message.clone()),
        _ => None,
    });
    warnings.collect()
}

use marf_engine::Event;

use super::format::{duration, node_counts};

/// Returns the line of an event, or `None` for progress.
pub fn sentence(event: &Event) -> Option<String> {
    let name = |node: &str| format!("{node:<22}");
    Some(match event {
        Event::WillRun { node, reason, .. } => format!("run     {} {reason}", name(node)),
        Event::Reused { node, .. } => format!("reuse   {}", name(node)),
        Event::Finished {
            node,
            seconds,
            counts,
            ..
        } => {
            format!(
                "done    {} {:>10}  {}",
                name(node),
                duration(*seconds),
                node_counts(counts).join(", ")
            )
        }
        Event::Failed { node, message, .. } => format!("failed  {} {message}", name(node)),
        Event::Skipped { node, reason } => format!("skip    {} {reason}", name(node)),
        Event::Warning { node, message } => {
            format!("warning {} {message}", name(node.as_deref().unwrap_or("")))
        }
        Event::Progress { .. } => return None,
    })
}

use marf_engine::Event;

/// Returns `3.2 s`, `2 min 05 s` or `1 h 02 min`.
pub fn duration(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match whole {
        0..60 => format!("{seconds:.1} s"),
        60..3600 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
    }
}

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
            let counts: Vec<String> = counts
                .iter()
                .map(|(what, count)| format!("{count} {what}"))
                .collect();
            format!(
                "done    {} {:>10}  {}",
                name(node),
                duration(*seconds),
                counts.join(", ")
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_choose_their_unit() {
        for (seconds, text) in [
            (0.04, "0.0 s"),
            (59.4, "59.4 s"),
            (60.0, "1 min 00 s"),
            (3725.0, "1 h 02 min"),
        ] {
            assert_eq!(duration(seconds), text);
        }
    }
}

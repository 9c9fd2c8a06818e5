use std::time::SystemTime;

use marf_engine::Event;
use schemars::{JsonSchema, Schema, generate::SchemaSettings};
use serde::Serialize;

/// A line of the output of `--json`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct Line<'a> {
    /// When it happened, as RFC 3339 in UTC with milliseconds, or `unknown` if the clock is before 1970.
    time: String,
    /// Name of the run, as in its record.
    run: &'a str,
    /// What happened.
    #[serde(flatten)]
    event: &'a Event,
}

impl<'a> Line<'a> {
    /// Returns the line of an event that happens now.
    pub fn now(run: &'a str, event: &'a Event) -> Self {
        let time = time_text(SystemTime::now());
        Self { time, run, event }
    }
}

fn time_text(time: SystemTime) -> String {
    if time < SystemTime::UNIX_EPOCH {
        "unknown".to_owned()
    } else {
        humantime::format_rfc3339_millis(time).to_string()
    }
}

/// Returns the JSON schema of the lines.
pub fn event_schema() -> Schema {
    let generator = SchemaSettings::draft2020_12().into_generator();
    let mut schema = generator.into_root_schema_for::<Line<'static>>();
    schema.insert("title".to_owned(), "An event of a run, one a line".into());
    schema
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_time_run_and_the_event_side_by_side() {
        let event = Event::Skipped {
            node: "blur".to_owned(),
            reason: "size failed".to_owned(),
        };
        let line = Line {
            time: "2026-11-22T08:00:00.000Z".to_owned(),
            run: "0a",
            event: &event,
        };
        assert_eq!(
            serde_json::to_string(&line).unwrap(),
            r#"{"time":"2026-11-22T08:00:00.000Z","run":"0a","event":"skipped","node":"blur","reason":"size failed"}"#
        );
    }

    #[test]
    fn a_time_before_1970_is_unknown() {
        let second = std::time::Duration::from_secs(1);
        assert_eq!(time_text(SystemTime::UNIX_EPOCH - second), "unknown");
        assert_eq!(
            time_text(SystemTime::UNIX_EPOCH + second),
            "1970-01-01T00:00:01.000Z"
        );
    }

    #[test]
    fn the_schema_names_every_kind_of_event() {
        let schema = serde_json::to_string(&event_schema()).unwrap();
        for kind in [
            "will_run", "reused", "progress", "finished", "failed", "skipped", "warning",
        ] {
            assert!(schema.contains(&format!("\"{kind}\"")), "{kind}");
        }
    }
}

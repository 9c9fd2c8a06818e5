//! Snapshots of what the verbs print: one file a verb, one transcript a test.
//!
//! After an intended change of a text: `INSTA_UPDATE=always cargo test --test verbs`, then read the diff of
//! `tests/verbs/snapshots`.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

#[path = "../common/mod.rs"]
mod common;
mod compare;
mod depth;
mod errors;
mod export;
mod file_numbers;
mod generated;
mod help;
mod json;
mod log;
mod numbers;
mod photos;
mod plan;
mod refusals;
mod scenes;
mod status;
mod trade;
mod why;

use std::path::Path;

use common::marf;

/// Extraction and two filters on the photos of one sol of the built-in Mars.
const SMALL: &str = r#"name = "small"
[archive.demo]
kind = "demo"
sols = "1"
width = 160

[node.extract]
archive = "demo"

[node.size]
input = "extract"
min_bytes = 2_000

[node.shape]
input = "size"
min_width = 120
min_height = 90
"#;

/// Returns a folder with a pipeline.toml of this text.
fn with_pipeline(text: &str) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("pipeline.toml"), text).unwrap();
    dir
}

/// Returns a folder in which [`SMALL`] has run.
fn after_a_run() -> tempfile::TempDir {
    common::ran("small", SMALL)
}

/// Runs commands one after the other and returns them with what each printed and its exit code.
fn transcript(folder: &Path, commands: &[&[&str]]) -> String {
    let mut text = String::new();
    for args in commands {
        let ran = marf(folder, args);
        text.push_str(&format!("$ marf {}\n{}", args.join(" "), ran.stdout));
        for line in ran.stderr.lines() {
            text.push_str(&format!("! {line}\n"));
        }
        text.push_str(&format!("[exit code {}]\n\n", ran.code));
    }
    text
}

/// Compares a transcript with its snapshot. Digests, times and dates are replaced by placeholders.
macro_rules! assert_transcript {
    ($folder:expr, $commands:expr) => {{
        let text = crate::transcript($folder, $commands);
        insta::with_settings!({
            prepend_module_to_snapshot => false,
            omit_expression => true,
            filters => crate::PLACEHOLDERS.to_vec(),
        }, { insta::assert_snapshot!(text) });
    }};
}
use assert_transcript;

/// Patterns of texts that vary between machines and runs, and their placeholders.
const PLACEHOLDERS: [(&str, &str); 8] = [
    (r"\b[0-9a-f]{64}\b", "[digest]"),
    (r"\b[0-9a-f]{12}\b", "[short digest]"),
    (r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", "[date]"),
    (r#""seconds": [0-9.e-]+"#, "\"seconds\": [seconds]"),
    (r#""memory_mb": [0-9]+"#, "\"memory_mb\": [MB]"),
    (r"pipeline-[0-9a-f]{8}", "pipeline-[digits]"),
    (
        r" *(\b(\d+ h \d\d min|\d+ min \d\d s|\d+(\.\d)? s|\d+ ms)|< 1 ms)\b",
        " [time]",
    ),
    (r"marf \d+\.\d+\.\d+", "marf [version]"),
];

//! marf: raw Mars rover and helicopter photos to radiance fields, with proof of how.
//!
//! The program in rooms: `config` reads pipeline.toml, `cli` has one file a verb, `progress` listens to the
//! engine, `show` writes the report. The work itself is done by the engine and the stages.

pub mod cli;
pub mod config;
pub mod progress;
pub mod show;

use std::io::Write as _;

/// Prints data to stdout; a reader that has gone away is not an error.
pub fn say(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

/// Prints talk to stderr.
pub fn talk(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

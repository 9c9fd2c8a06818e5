//! marf: raw Mars rover and helicopter photos to radiance fields, with proof of how.
//!
//! The program's modules: `config` reads pipeline.toml, `cli` has one file a verb, `progress` prints the engine's
//! events. The work itself is done by the engine and the stages.

pub mod cli;
pub mod config;
mod nearest;
pub mod progress;
pub mod terminal;

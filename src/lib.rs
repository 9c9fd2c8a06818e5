//! marf: raw Mars rover and helicopter photos to radiance fields, with proof of how.
//!
//! The program in rooms: `config` reads pipeline.toml, `cli` has one file a verb, `progress` listens to the
//! engine, `show` writes the report. The work itself is done by the engine and the stages.

pub mod config;
pub mod show;

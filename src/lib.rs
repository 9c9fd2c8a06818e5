//! marf: raw Mars rover and helicopter photos to radiance fields, with proof of how.
//!
//! The command line: `cli` has one file a verb. The work itself is done by the engine and the stages.

pub mod cli;
pub mod terminal;

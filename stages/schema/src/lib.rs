//! Parameters and outputs of `scenes`, `masks`, `calibrate`, `cameras`, `tune`, `train`, `partial`, `folds`, `evaluate`, `render`,
//! `bootstrap`, `video`, `depth`, `surface`, `changes` and `ties`.
//!
//! One module a stage: its parameters ([`Params`](marf_stage::Params)) with the checks that need no input, and each
//! JSON output ([`Document`](marf_stage::Document)). Stages, commands and the report read and write these types, so
//! that a field that is renamed or gone fails to compile. Names of outputs that are not JSON are in [`output`].
//!
//! Invariant: the order of fields, `rename` and `skip_serializing_if` decide stored bytes and keys, which
//! hold parameters as JSON. A change needs a new version of the stage.
//!
//! Parameters of filters and of archives are not here: each is in the file of its filter or archive.

pub mod bootstrap;
mod budget;
pub mod calibrate;
pub mod cameras;
pub mod changes;
mod check;
pub mod depth;
pub mod evaluate;
pub mod example;
pub mod folds;
pub mod masks;
mod memory;
mod names;
pub mod output;
pub mod partial;
pub mod render;
pub mod rigs;
pub mod scenes;
pub mod scores;
pub mod surface;
mod target;
pub mod ties;
pub mod train;
pub mod tune;
pub mod video;

//! Parameters and outputs of `scenes`, `masks`, `calibrate`, `cameras`, `tune`, `train`, `partial`, `folds`, `evaluate`, `render`,
//! `bootstrap`, `video`, `surface`, `changes` and `ties`.
//!
//! One module a stage: its parameters ([`Params`](marf_stage::Params)) with the checks that need no input, and each
//! JSON output ([`Document`](marf_stage::Document)). Stages, commands and the report read and write these types, so
//! that a field that is renamed or gone fails to compile. Names of outputs that are not JSON are in [`output`].
//!
//! Invariant: the order of fields, `rename` and `skip_serializing_if` decide stored bytes and keys, which hold
//! parameters as JSON; a change needs a new version of the stage.
//!
//! Parameters of filters and of archives are not here: they stand in the one file of the filter or archive.

pub mod bootstrap;
mod budget;
pub mod calibrate;
pub mod cameras;
pub mod changes;
pub mod evaluate;
pub mod example;
pub mod folds;
pub mod masks;
mod memory;
pub mod output;
pub mod partial;
pub mod render;
pub mod scenes;
pub mod scores;
pub mod surface;
mod target;
pub mod ties;
pub mod train;
pub mod tune;
pub mod video;

use marf_field::Overrides;
use marf_stage::ParamError;

/// Checks a factor by which photos are shrunk.
///
/// # Errors
/// 0.
pub(crate) fn check_scale(scale: Option<u32>) -> Result<(), ParamError> {
    match scale {
        Some(0) => Err(ParamError::new(
            "scale",
            "photos cannot be shrunk by 0; 1 keeps them",
        )),
        _ => Ok(()),
    }
}

/// Checks keys of the field against the configuration they are laid over.
///
/// # Errors
/// Names the key that is unknown, of another type or out of its range.
pub(crate) fn check_field(fit: train::Fit, field: &Overrides) -> Result<(), ParamError> {
    let checked = field.over(&fit.config());
    checked.map(|_| ()).map_err(|error| {
        let path = format!("field.{}", error.key);
        ParamError::new(path.trim_end_matches('.'), error.message)
    })
}

//! Checks that parameters of several stages share.

use marf_field::{Config, Overrides};
use marf_stage::ParamError;

/// Checks a factor by which photos are shrunk.
///
/// # Errors
/// 0.
pub(crate) fn check_scale(scale: Option<u32>) -> Result<(), ParamError> {
    match scale {
        Some(0) => Err(ParamError::new(
            "scale",
            "photos cannot be shrunk by 0: 1 keeps their size",
        )),
        _ => Ok(()),
    }
}

/// Checks keys of the field against the configuration they are laid over.
///
/// # Errors
/// Names the key that is unknown, of another type or out of its range.
pub(crate) fn check_field(base: &Config, field: &Overrides) -> Result<(), ParamError> {
    let checked = field.over(base);
    checked.map(|_| ()).map_err(|error| {
        let path = format!("field.{}", error.key);
        ParamError::new(path.trim_end_matches('.'), error.message)
    })
}

/// Checks a share of the steps of a training.
pub(crate) fn check_share(path: &str, share: f64) -> Result<(), ParamError> {
    if share > 0.0 && share <= 1.0 {
        return Ok(());
    }
    let message = format!("{share} of the steps is not above 0 and at most 1");
    Err(ParamError::new(path, message))
}

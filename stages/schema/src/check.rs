//! Checks that parameters of several stages share.

use std::{fmt::Display, ops::RangeInclusive};

use marf_field::{Config, Overrides};
use marf_stage::ParamError;

/// Checks that a number is in its range, with both ends.
///
/// # Errors
/// A number outside, or NaN.
pub(crate) fn check_within<T: PartialOrd + Display>(
    key: &str,
    value: T,
    range: RangeInclusive<T>,
) -> Result<(), ParamError> {
    if range.contains(&value) {
        return Ok(());
    }
    let message = format!("{value} is not within {} to {}", range.start(), range.end());
    Err(ParamError::new(key, message))
}

/// Checks a length, if there is one.
///
/// # Errors
/// A length that is 0, negative, infinite or NaN.
pub(crate) fn check_length(key: &str, length: Option<f64>) -> Result<(), ParamError> {
    match length {
        Some(length) if !length.is_finite() || length <= 0.0 => {
            let message = format!("{length} is not a finite length above 0");
            Err(ParamError::new(key, message))
        }
        _ => Ok(()),
    }
}

/// Checks the steps of a training, if they are set.
///
/// # Errors
/// 0.
pub(crate) fn check_steps(steps: Option<u64>) -> Result<(), ParamError> {
    match steps {
        Some(0) => Err(ParamError::new("steps", "0 steps train nothing: use at least 1")),
        _ => Ok(()),
    }
}

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

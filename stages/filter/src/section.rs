//! What a filter adds to a survey of photos, and how its measures are kept.

use marf_cache::manifest::Row;
#[cfg(test)]
use marf_stage::Define;
use marf_stage::{Ctx, StageError, Table};

use crate::decoded::DecodedPhoto;

/// First byte of the measure of a photo that cannot be decoded, followed by the reason.
pub(crate) const REFUSED: u8 = 0;
/// First byte of the measure of a decoded photo, followed by the filter's measure.
pub(crate) const MEASURED: u8 = 1;

/// The part of a survey that belongs to one filter.
pub(crate) struct Section {
    /// Where the measures are kept: the name of the filter and the version of its measure.
    pub(crate) table: Table,
    /// Measures a photo. Only the filter itself reads the bytes.
    pub(crate) measure: fn(&Ctx<'_>, &DecodedPhoto<'_>) -> Result<Vec<u8>, StageError>,
}

/// A stage of the table of filters.
pub(crate) trait Surveyed {
    /// Its part of a survey. `None` for a filter that needs the facts alone.
    const SECTION: Option<Section>;
    /// Digests of its answers on fixed photos.
    #[cfg(test)]
    const GUARD: Guard;
}

/// Digests of a filter's answers on the photos of the guards, each behind the version it belongs to.
///
/// Where a digest changed and its version did not: raise the version of the filter, then write the new line.
#[cfg(test)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Guard {
    /// MEASURE_VERSION, and the digest of the measures. Empty for a filter without a measure.
    pub measures: &'static str,
    /// VERSION, and the digest of the verdicts.
    pub decisions: &'static str,
}

/// A row of the table with its guard.
#[cfg(test)]
pub(crate) struct Guarded {
    pub(crate) name: &'static str,
    pub(crate) version: u32,
    pub(crate) measure_version: Option<u32>,
    pub(crate) guard: Guard,
}

#[cfg(test)]
impl Guarded {
    pub(crate) const fn new<S: Define + Surveyed>() -> Self {
        Self {
            name: S::NAME,
            version: S::VERSION,
            measure_version: match S::SECTION {
                Some(section) => Some(section.table.version),
                None => None,
            },
            guard: S::GUARD,
        }
    }
}

/// Returns a filter's measure of a photo, or the reason why the photo could not be decoded.
///
/// # Errors
/// Bytes that are not a measure.
pub(crate) fn measured<'a>(measure: &'a [u8], row: &Row) -> Result<Result<&'a [u8], String>, StageError> {
    match measure.split_first() {
        Some((&REFUSED, reason)) => Ok(Err(String::from_utf8_lossy(reason).into_owned())),
        Some((&MEASURED, part)) => Ok(Ok(part)),
        _ => Err(unreadable(row, "its first byte is neither 0 nor 1")),
    }
}

/// Returns the error of a kept measure that differs from the written one.
pub(crate) fn unreadable(row: &Row, cause: impl std::fmt::Display) -> StageError {
    damaged(format!("measure of `{}` cannot be read", row.id)).cause(cause.to_string())
}

/// Returns the error of something kept that cannot be read, with what to do about it.
pub(crate) fn damaged(message: String) -> StageError {
    StageError::new(message).hint("the store may be damaged: measure again in an empty one, `--store DIR`")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row() -> Row {
        Row {
            id: "a".to_owned(),
            blobs: Default::default(),
            facts: serde_json::Value::Null,
        }
    }

    #[test]
    fn a_measure_or_the_reason_comes_back_and_damage_is_an_error() {
        assert_eq!(measured(b"\x01sharp", &row()).unwrap(), Ok(&b"sharp"[..]));
        assert_eq!(measured(b"\x01", &row()).unwrap(), Ok(&b""[..]));
        assert_eq!(measured(b"\0cut", &row()).unwrap(), Err("cut".to_owned()));
        for damaged in [&b""[..], b"{}", b"\x07"] {
            let error = measured(damaged, &row()).unwrap_err().to_string();
            assert!(error.contains("`a`"), "{error}");
        }
    }
}

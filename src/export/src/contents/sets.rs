//! Sets of photos and verdicts, whose readers' errors get a name.

use std::{fmt, sync::Arc};

use marf_cache::{
    Digest,
    manifest::{LeafRef, Row},
};
use marf_engine::sets;
use marf_stage::Verdict;

use super::objects::ReadObject;
use crate::error::ExportError;

/// Returns the leaves of a set, in order. `what` names it in errors.
///
/// # Errors
/// An object that cannot be read, or is not a set.
pub fn leaves(root: &Digest, read: &ReadObject<'_>, what: &str) -> Result<Vec<LeafRef>, ExportError> {
    sets::leaves(root, part_of(read)).map_err(|error| unreadable(what, error))
}

/// Returns the rows of a set, shard by shard, sorted by id in each.
///
/// # Errors
/// As [`leaves`].
pub fn rows(root: &Digest, read: &ReadObject<'_>, what: &str) -> Result<Vec<Row>, ExportError> {
    sets::rows(root, part_of(read)).map_err(|error| unreadable(what, error))
}

/// Returns the verdicts of a set of verdicts, in its order.
///
/// # Errors
/// As [`leaves`].
pub fn verdicts(root: &Digest, read: &ReadObject<'_>, what: &str) -> Result<Vec<Verdict>, ExportError> {
    sets::verdicts(root, part_of(read)).map_err(|error| unreadable(what, error))
}

/// Returns a reader of the objects of a set.
fn part_of(read: &ReadObject<'_>) -> impl FnMut(&Digest) -> Result<Arc<[u8]>, String> {
    |digest| read(digest).map_err(|cause| format!("object {}: {cause}", digest.short()))
}

/// Returns the error of something that cannot be read.
pub(super) fn unreadable(what: &str, error: impl fmt::Display) -> ExportError {
    ExportError::Unreadable(format!("{what} cannot be read: {error}"))
}

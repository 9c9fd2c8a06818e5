//! Sets of photos and verdicts, whose readers' errors get a name.

use std::sync::Arc;

use marf_cache::{
    Digest,
    manifest::{LeafRef, ManifestError, Row},
};
use marf_engine::sets;
use marf_stage::Verdict;

use super::objects::ReadObject;
use crate::error::ExportError;

/// Why a set cannot be read.
enum Fault {
    Object(Digest, String),
    Malformed(ManifestError),
}

impl From<ManifestError> for Fault {
    fn from(error: ManifestError) -> Self {
        Self::Malformed(error)
    }
}

/// Returns the leaves of a set, in order. `what` names it in errors.
///
/// # Errors
/// An object that cannot be read, or is not a set.
pub fn leaves(root: &Digest, read: &ReadObject<'_>, what: &str) -> Result<Vec<LeafRef>, ExportError> {
    named(what, sets::leaves(root, getter(read)))
}

/// Returns the rows of a set, shard by shard, sorted by id in each.
///
/// # Errors
/// As [`leaves`].
pub fn rows(root: &Digest, read: &ReadObject<'_>, what: &str) -> Result<Vec<Row>, ExportError> {
    named(what, sets::rows(root, getter(read)))
}

/// Returns the verdicts of a set of verdicts, in its order.
///
/// # Errors
/// As [`leaves`].
pub fn verdicts(root: &Digest, read: &ReadObject<'_>, what: &str) -> Result<Vec<Verdict>, ExportError> {
    named(what, sets::verdicts(root, getter(read)))
}

fn getter(read: &ReadObject<'_>) -> impl FnMut(&Digest) -> Result<Arc<[u8]>, Fault> {
    |digest| read(digest).map_err(|cause| Fault::Object(*digest, cause))
}

fn named<T>(what: &str, read: Result<T, Fault>) -> Result<T, ExportError> {
    read.map_err(|fault| match fault {
        Fault::Object(digest, cause) => ExportError::Object {
            digest,
            what: format!("a part of {what}"),
            cause,
        },
        Fault::Malformed(cause) => ExportError::BadSet {
            what: what.to_owned(),
            cause,
        },
    })
}

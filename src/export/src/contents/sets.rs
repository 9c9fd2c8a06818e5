//! Sets of photos and verdicts.

use marf_cache::{
    Digest,
    manifest::{Leaf, LeafRef, ManifestError, Root, Row},
};
use marf_stage::Verdict;

use super::{ReadObject, object};
use crate::error::ExportError;

/// The objects that a set consists of.
#[derive(Debug, Default)]
pub struct Members {
    /// Its blocks.
    pub blocks: Vec<Digest>,
    /// Its leaves, in order.
    pub leaves: Vec<LeafRef>,
}

/// Returns the objects that a set consists of; `what` names it in errors.
///
/// # Errors
/// An object that cannot be read, or is no set.
pub fn members(root: &Digest, read: &ReadObject<'_>, what: &str) -> Result<Members, ExportError> {
    let bad = |cause: ManifestError| ExportError::BadSet {
        what: what.to_owned(),
        cause,
    };
    let bytes = object(read, root, || what.to_owned())?;
    let blocks = Root::blocks(&bytes).map_err(bad)?;
    let blocks: Vec<Digest> = blocks.into_iter().map(|block| block.digest).collect();
    let mut leaves = Vec::new();
    for block in &blocks {
        let bytes = object(read, block, || format!("a block of {what}"))?;
        leaves.extend(Root::decode_leaves(&bytes).map_err(bad)?);
    }
    Ok(Members { blocks, leaves })
}

/// Returns the rows of a set, shard by shard, sorted by id in each.
///
/// # Errors
/// As [`members`].
pub fn rows(root: &Digest, read: &ReadObject<'_>, what: &str) -> Result<Vec<Row>, ExportError> {
    let mut rows = Vec::new();
    for leaf in members(root, read, what)?.leaves {
        let bytes = object(read, &leaf.leaf, || format!("a leaf of {what}"))?;
        let leaf = Leaf::decode(&bytes).map_err(|cause| ExportError::BadSet {
            what: what.to_owned(),
            cause,
        })?;
        rows.extend(leaf.rows);
    }
    Ok(rows)
}

/// Returns the verdicts of a set of verdicts, in its order.
///
/// # Errors
/// As [`members`].
pub fn verdicts(root: &Digest, read: &ReadObject<'_>, what: &str) -> Result<Vec<Verdict>, ExportError> {
    let mut verdicts = Vec::new();
    for leaf in members(root, read, what)?.leaves {
        let bytes = object(read, &leaf.leaf, || format!("a leaf of {what}"))?;
        for line in bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
            let verdict = serde_json::from_slice(line).map_err(|error| ExportError::BadSet {
                what: what.to_owned(),
                cause: error.into(),
            })?;
            verdicts.push(verdict);
        }
    }
    Ok(verdicts)
}

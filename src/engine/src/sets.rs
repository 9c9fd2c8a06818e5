//! Sets of photos and of verdicts, read from wherever their blobs are.

use std::sync::Arc;

use marf_cache::Digest;
use marf_cache::manifest::{Leaf, LeafRef, ManifestError, Root, Row};
use marf_stage::Verdict;

/// Reads the leaves of a set.
///
/// # Errors
/// The first error of `get`, or bytes that are not a set.
pub fn leaves<E: From<ManifestError>>(
    root: &Digest,
    get: impl FnMut(&Digest) -> Result<Arc<[u8]>, E>,
) -> Result<Vec<LeafRef>, E> {
    Ok(Root::read(root, get)?.leaves)
}

/// Reads all rows of a set.
///
/// # Errors
/// The first error of `get`, or bytes that are not a set.
pub fn rows<E: From<ManifestError>>(
    root: &Digest,
    mut get: impl FnMut(&Digest) -> Result<Arc<[u8]>, E>,
) -> Result<Vec<Row>, E> {
    let mut rows = Vec::new();
    for leaf in leaves(root, &mut get)? {
        rows.extend(Leaf::decode(&get(&leaf.leaf)?)?.rows);
    }
    Ok(rows)
}

/// Reads all verdicts of a node.
///
/// # Errors
/// The first error of `get`, or bytes that are not verdicts.
pub fn verdicts<E: From<ManifestError>>(
    root: &Digest,
    mut get: impl FnMut(&Digest) -> Result<Arc<[u8]>, E>,
) -> Result<Vec<Verdict>, E> {
    let mut verdicts = Vec::new();
    for leaf in leaves(root, &mut get)? {
        verdicts.extend(parse(&get(&leaf.leaf)?)?);
    }
    Ok(verdicts)
}

/// Reads the verdicts of a leaf, one JSON object a line.
///
/// # Errors
/// Bytes that are not verdicts.
pub fn parse(bytes: &[u8]) -> Result<Vec<Verdict>, ManifestError> {
    let lines = bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
    lines.map(|line| Ok(serde_json::from_slice(line)?)).collect()
}

//! Sets of photos, read.

use marf_cache::Digest;
use marf_cache::manifest::{Leaf, ManifestError, Root, Row};

use crate::{Ctx, StageError};

impl From<ManifestError> for StageError {
    fn from(error: ManifestError) -> Self {
        Self::new(format!("the set of photos: {error}"))
    }
}

/// Returns the rows of a set of photos, each with its sol, in order of sol and id.
///
/// # Errors
/// A set that is lost or damaged.
pub fn rows_of(ctx: &Ctx<'_>, set: &Digest) -> Result<Vec<(u32, Row)>, StageError> {
    let root = Root::read(set, |digest| ctx.get(digest))?;
    let mut rows = Vec::new();
    for leaf in &root.leaves {
        let read = Leaf::decode(&ctx.get(&leaf.leaf)?)?;
        rows.extend(read.rows.into_iter().map(|row| (leaf.shard, row)));
    }
    Ok(rows)
}

//! Outputs of finished nodes.

use marf_cache::Digest;
use marf_stage::{Ctx, Document, Outputs, StageError};

/// Returns an output of a finished node.
pub(super) fn digest(outputs: &Outputs, name: &str) -> Result<Digest, StageError> {
    let found = outputs.get(name).copied();
    found.ok_or_else(|| StageError::new(format!("a node below gave no output `{name}`")))
}

/// Reads a document of a finished node.
pub(super) fn document<D: Document>(ctx: &Ctx<'_>, outputs: &Outputs) -> Result<D, StageError> {
    let bytes = ctx.get(&digest(outputs, D::OUTPUT)?)?;
    D::decode(&bytes)
        .map_err(|error| StageError::new(format!("output `{}` of a node below: {error}", D::OUTPUT)))
}

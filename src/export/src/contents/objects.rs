//! Objects of the store that a run is in.

use std::sync::Arc;

use marf_cache::{Action, Digest};
use marf_model::{Run, RunNode};

use crate::error::ExportError;

/// Reads an object of a store or a crate and verifies it. The error is a sentence for people.
pub type ReadObject<'a> = dyn Fn(&Digest) -> Result<Arc<[u8]>, String> + 'a;

/// Reads the action of a node.
pub(crate) fn read_action(run: &Run<'_>, node: &RunNode) -> Result<Action, ExportError> {
    let key = node.run.key.ok_or_else(|| ExportError::Unfinished {
        id: run.record.id.clone(),
        outcome: format!("`{}` has none", node.run.name),
    })?;
    let bytes = object(run, &key, || format!("the action of `{}`", node.run.name))?;
    Action::decode(&bytes).map_err(|cause| {
        ExportError::Unreadable(format!(
            "the action of `{}` cannot be read: {cause}",
            node.run.name
        ))
    })
}

/// Reads an object of the store of a run, or says which one cannot be read.
pub(crate) fn object(
    run: &Run<'_>,
    digest: &Digest,
    what: impl FnOnce() -> String,
) -> Result<Arc<[u8]>, ExportError> {
    run.store().get(digest).map_err(|error| {
        let (what, object) = (what(), digest.short());
        ExportError::Unreadable(format!("{what} (object {object}) cannot be read: {error}"))
    })
}

/// Returns a reader of the objects of the store of a run.
pub(crate) fn reader<'r>(run: &Run<'r>) -> impl Fn(&Digest) -> Result<Arc<[u8]>, String> + use<'r> {
    let store = run.store();
    move |digest| store.get(digest).map_err(|error| error.to_string())
}

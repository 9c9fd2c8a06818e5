//! Requirements on a run for its export.

use marf_engine::{Outcome, RunRecord};

use crate::error::ExportError;

/// Refuses a run in which a node has no result.
///
/// # Errors
/// [`ExportError::Unfinished`].
pub(crate) fn check_finished(run: &RunRecord) -> Result<(), ExportError> {
    let unfinished = |outcome: String| ExportError::Unfinished {
        id: run.id.clone(),
        outcome,
    };
    if run.outcome != Outcome::Done {
        return Err(unfinished(format!("{:?}", run.outcome).to_lowercase()));
    }
    let mut nodes = run.nodes.iter();
    match nodes.find(|node| node.key.is_none() || !node.state.is_good()) {
        None => Ok(()),
        Some(node) => Err(unfinished(format!("`{}` has none", node.name))),
    }
}

//! Errors of nodes whose jobs cannot be made.

use std::fmt;

use marf_remote::RemoteError;
use marf_stage::StageError;

/// Returns the error of a node for which something cannot be done.
pub(crate) fn failed(node: &str, what: &str, error: &dyn fmt::Display) -> StageError {
    StageError::new(format!("`{node}`: {what}")).cause(error.to_string())
}

/// Returns the error of a node for which the shared store cannot do something.
pub(crate) fn remote_failed(node: &str, what: &str, error: RemoteError) -> StageError {
    match error {
        RemoteError::Stopped => StageError::Cancelled,
        error => failed(node, what, &error),
    }
}

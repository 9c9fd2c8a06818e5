//! Errors of stages that the engine itself makes.

use marf_cache::StoreError;
use marf_stage::{BlobError, StageError};

/// Returns the error of a stage that broke its contract.
pub(crate) fn contract_violation(message: String) -> StageError {
    StageError::new(message).cause("the stage does not keep its contract, which is a bug of the stage")
}

/// Returns the error of a stage that panicked, from the payload of the panic.
pub(crate) fn panicked(payload: &(dyn std::any::Any + Send)) -> StageError {
    let text = payload.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned());
    StageError::new(format!(
        "panicked: {}",
        text.unwrap_or_else(|| "no message".to_owned())
    ))
    .cause("a panic is a bug of marf, whatever the input")
    .hint("report it with the command and the pipeline")
}

/// Converts an error of the store into that of a blob.
pub(crate) fn blob_error(error: StoreError) -> BlobError {
    BlobError {
        lost: error.lost(),
        message: error.to_string(),
    }
}

/// Converts an error of the store into that of a stage.
pub(crate) fn store_error(error: StoreError) -> StageError {
    StageError::Blob(blob_error(error))
}

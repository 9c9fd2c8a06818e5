//! Errors of the mapper as those of the stage.

use marf_sfm::mapper::MapError;
use marf_stage::StageError;

/// Returns the error of the stage for that of a mapping.
pub(super) fn failed(error: MapError) -> StageError {
    match error {
        MapError::Stopped => StageError::Cancelled,
        other => StageError::new(other.to_string()),
    }
}

//! Points of photos whose cameras are known.

use marf_scene::{Camera, Pose};

use super::input::{MapError, MapperInput};
use super::model::Model;

/// Returns the model of photos whose cameras are known, with every track that fits as a point; nothing is adjusted.
///
/// `known`: pose and working-size camera of each photo; photos without are left out. `None` if no photo is known.
///
/// # Errors
/// A request to stop.
pub fn triangulate(
    input: &MapperInput<'_>,
    known: &[Option<(Pose, Camera)>],
) -> Result<Option<Model>, MapError> {
    let model = Model::known(input, known);
    match input.supervisor.stop() {
        true => Err(MapError::Stopped),
        false => Ok(model),
    }
}

//! Points of photos whose cameras are known.

use super::input::{MapError, MapperInput};
use super::model::Model;
use crate::view_graph::PosedCamera;

/// Returns the model of photos whose cameras are known, with every track that fits as a point. Nothing is adjusted.
///
/// `known`: working-size camera and pose of each photo. Photos without are left out. `None` if no photo is known.
///
/// # Errors
/// A request to stop.
pub fn triangulate(
    input: &MapperInput<'_>,
    known: &[Option<PosedCamera>],
) -> Result<Option<Model>, MapError> {
    let model = Model::known(input, known);
    input.check_stop()?;
    Ok(model)
}

//! Registration of new photos in an earlier scene.

use super::global_adjustment::{FINE, refine};
use super::input::{MapError, MapperInput};
use super::model::Model;
use super::register::register_all;
use crate::align::{PosePair, Tolerance, align};
use crate::view_graph::PosedCamera;

/// Returns the model of an earlier scene with all new photos registered that fit it, in the frame of the earlier scene.
///
/// `known`: working-size camera and pose of each photo of the earlier scene. All poses are adjusted, then the model is
/// aligned with the earlier poses. `None` if no photo is known.
pub fn extend(input: &MapperInput<'_>, known: &[Option<PosedCamera>]) -> Result<Option<Model>, MapError> {
    let Some(model) = Model::known(input, known) else {
        return Ok(None);
    };
    let mut model = register_all(input, model, &vec![false; input.views.len()])?;
    refine(input, &mut model, &[], FINE)?;
    input.check_stop()?;
    align_with(&mut model, known);
    Ok(Some(model))
}

/// Transforms a model so that its poses are nearest to known ones.
fn align_with(model: &mut Model, known: &[Option<PosedCamera>]) {
    let pairs = model.poses.iter().zip(known).filter_map(|(now, before)| {
        Some(PosePair {
            cam_from_source: (*now)?,
            cam_from_target: before.as_ref()?.cam_from_world,
        })
    });
    let pairs: Vec<PosePair> = pairs.collect();
    let any = Tolerance {
        distance: f64::INFINITY,
        angle_rad: f64::INFINITY,
    };
    if let Some(alignment) = align(&pairs, &any) {
        model.transform(&alignment.similarity);
    }
}

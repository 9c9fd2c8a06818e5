//! Registration of new photos in an earlier scene.

use marf_scene::{Camera, Pose};

use super::global_adjustment::{FINE, refine};
use super::input::{MapError, MapperInput};
use super::model::Model;
use super::register::register_all;
use crate::align::{Tolerance, align};

/// Returns the model of an earlier scene with all new photos registered that fit it, in the frame of the earlier scene.
///
/// `known`: pose and working-size camera of each photo of the earlier scene. All poses are adjusted, then the model is
/// aligned with the earlier poses. `None` if no photo is known.
pub fn extend(input: &MapperInput<'_>, known: &[Option<(Pose, Camera)>]) -> Result<Option<Model>, MapError> {
    let Some(anchor) = known.iter().position(Option::is_some) else {
        return Ok(None);
    };
    let mut model = Model::empty(input, anchor);
    for (photo, known) in known.iter().enumerate() {
        if let Some((pose, camera)) = known {
            model.poses[photo] = Some(*pose);
            model.cameras[input.views[photo].camera] = *camera;
        }
    }
    model.set_lens_from_cameras();
    model.complete(input, input.tracks.all());
    let mut model = register_all(input, model, &vec![false; input.views.len()])?;
    refine(input, &mut model, &[], FINE)?;
    align_with(&mut model, known);
    Ok(Some(model))
}

/// Transforms a model so that its poses are nearest to known ones.
fn align_with(model: &mut Model, known: &[Option<(Pose, Camera)>]) {
    let pairs: Vec<(Pose, Pose)> = (model.poses.iter().zip(known))
        .filter_map(|(now, before)| Some(((*now)?, before.as_ref()?.0)))
        .collect();
    let any = Tolerance {
        distance: f64::INFINITY,
        angle_rad: f64::INFINITY,
    };
    if let Some(alignment) = align(&pairs, &any) {
        model.transform(&alignment.similarity);
    }
}

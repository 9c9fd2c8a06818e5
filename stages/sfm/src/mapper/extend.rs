//! Registration of new photos in an earlier scene.

use super::checkpoint::{PART, fingerprint, is_due};
use super::global_adjustment::{FINE, refine};
use super::input::{MapError, MapperInput};
use super::model::Model;
use super::register::{GrowingModel, Progress};
use crate::align::{PosePair, Tolerance, align};
use crate::bytes;
use crate::view_graph::PosedCamera;

/// Form of the saved state. A new number for any change of how it is written or used.
const FORM: &[u8; 8] = b"extends2";

/// Returns the model of an earlier scene with all new photos registered that fit it, in the frame of the earlier scene.
///
/// `known`: working-size camera and pose of each photo of the earlier scene. All poses are adjusted, then the model is
/// aligned with the earlier poses. `None` if no photo is known.
pub fn extend(input: &MapperInput<'_>, known: &[Option<PosedCamera>]) -> Result<Option<Model>, MapError> {
    let Some(model) = Model::known(input, known) else {
        return Ok(None);
    };
    let mut model = grown(input, model)?;
    refine(input, &mut model, &[], FINE)?;
    align_with(&mut model, known);
    Ok(Some(model))
}

/// Adds photos until none fits, from the state that an unfinished run has saved.
fn grown(input: &MapperInput<'_>, model: Model) -> Result<Model, MapError> {
    let fingerprint = bytes::fingerprint(&(fingerprint(input), &model));
    let saved = input.supervisor.load(PART);
    let saved = saved.and_then(|saved| bytes::decode(&saved, FORM, fingerprint));
    let mut growing = saved.unwrap_or_else(|| GrowingModel::new(model));
    let taken = vec![false; input.views.len()];
    while growing.step(input, &taken)? == Progress::Unfinished {
        if is_due(input)? {
            let state = bytes::encode(FORM, fingerprint, &growing);
            input.supervisor.save(PART, &state);
        }
    }
    Ok(growing.model)
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

//! Registration of new photos in an earlier scene.

use marf_scene::{Camera, Pose};

use super::checkpoint::{PART, fingerprint, is_due};
use super::global_adjustment::{FINE, refine};
use super::input::{MapError, MapperInput};
use super::model::Model;
use super::register::{Growing, Growth};
use crate::align::{Tolerance, align};
use crate::bytes::{Fingerprint, Reader, Writer};

/// Form of the saved state; a new number where it is written or used otherwise.
const FORM: &[u8; 8] = b"extends1";

/// Returns the model of an earlier scene with all new photos registered that fit it, in the frame of the earlier scene.
///
/// `known`: pose and working-size camera of each photo of the earlier scene. All poses are adjusted, then the model is
/// aligned with the earlier poses. `None` if no photo is known.
pub fn extend(input: &MapperInput<'_>, known: &[Option<(Pose, Camera)>]) -> Result<Option<Model>, MapError> {
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
    let mut writer = Writer::new(FORM, fingerprint(input));
    model.write(&mut writer);
    let mut of = Fingerprint::new();
    of.add_state(writer);
    let mut growing = resume(input, of.value()).unwrap_or_else(|| Growing::new(model));
    let taken = vec![false; input.views.len()];
    while growing.step(input, &taken)? == Growth::Unfinished {
        if is_due(input)? {
            let mut writer = Writer::new(FORM, of.value());
            growing.write(&mut writer);
            input.supervisor.save(PART, &writer.finish());
        }
    }
    Ok(growing.model)
}

/// Returns the state that an unfinished run has saved.
fn resume(input: &MapperInput<'_>, of: u64) -> Option<Growing> {
    let saved = input.supervisor.load(PART)?;
    let mut reader = Reader::new(&saved, FORM, of)?;
    let growing = Growing::read(input, &mut reader)?;
    reader.end()?;
    Some(growing)
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

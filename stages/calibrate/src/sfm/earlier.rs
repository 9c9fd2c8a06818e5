//! The scene of an earlier run, to which new photos are added.

use marf_scene::Scene;
use marf_sfm::view_graph::PosedCamera;
use marf_stage::{Ctx, Inputs, StageError};

use super::photo_features::PhotoFeatures;
use crate::photos::InputPhoto;

/// A scene of an earlier run.
pub(super) struct EarlierScene {
    pub scene: Scene,
    /// Working-size camera and pose of each photo that was in it.
    pub known: Vec<Option<PosedCamera>>,
}

/// Reads the scene of the last run, if one is connected.
pub(crate) fn earlier_scene(ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Option<Scene>, StageError> {
    let Some(digest) = inputs.optional(marf_stage::EARLIER) else {
        return Ok(None);
    };
    let scene = Scene::decode(&ctx.get(digest)?);
    let scene = scene.map_err(|error| StageError::new(format!("the earlier scene: {error}")))?;
    Ok(Some(scene))
}

/// Returns the earlier scene, if one is connected and has at least two photos of this set.
pub(super) fn load(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[InputPhoto],
    features: &[PhotoFeatures],
) -> Result<Option<EarlierScene>, StageError> {
    let Some(scene) = earlier_scene(ctx, inputs)? else {
        return Ok(None);
    };
    let known = items.iter().zip(features).map(|(item, features)| {
        let frame = scene.frame(&item.id)?;
        Some(PosedCamera {
            camera: features.row.at_working_size(&frame.camera),
            cam_from_world: frame.cam_from_world,
        })
    });
    let known: Vec<_> = known.collect();
    let enough = known.iter().flatten().count() >= 2;
    Ok(enough.then_some(EarlierScene { scene, known }))
}

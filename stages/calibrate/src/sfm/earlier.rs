//! The scene of an earlier run, to which new photos are added.

use marf_scene::Scene;
use marf_sfm::mapper::MapperInput;
use marf_sfm::view_graph::PosedCamera;
use marf_stage::{Ctx, Inputs, StageError};

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
    input: &MapperInput<'_>,
) -> Result<Option<EarlierScene>, StageError> {
    let Some(scene) = earlier_scene(ctx, inputs)? else {
        return Ok(None);
    };
    let known = items.iter().enumerate().map(|(photo, item)| {
        let frame = scene.frame(&item.id)?;
        let size = &input.cameras[input.views[photo].camera].camera;
        Some(PosedCamera {
            camera: frame.camera.resized(size.width, size.height),
            cam_from_world: frame.cam_from_world,
        })
    });
    let known: Vec<_> = known.collect();
    let enough = known.iter().flatten().count() >= 2;
    Ok(enough.then_some(EarlierScene { scene, known }))
}

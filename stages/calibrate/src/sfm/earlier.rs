//! The scene of an earlier run, to which new photos are added.

use marf_scene::{Camera, Pose, Scene};
use marf_sfm::mapper::MapperInput;
use marf_stage::{Ctx, Inputs, StageError};

use crate::photos::InputPhoto;

/// A scene of an earlier run.
pub(super) struct Earlier {
    pub scene: Scene,
    /// Pose and working-size camera of each photo that was in it.
    pub known: Vec<Option<(Pose, Camera)>>,
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
) -> Result<Option<Earlier>, StageError> {
    let Some(scene) = earlier_scene(ctx, inputs)? else {
        return Ok(None);
    };
    let known = items.iter().enumerate().map(|(photo, item)| {
        let frame = scene.frame(&item.id)?;
        let size = &input.cameras[input.views[photo].camera].camera;
        Some((
            frame.cam_from_world,
            frame.camera.resized(size.width, size.height),
        ))
    });
    let known: Vec<_> = known.collect();
    let enough = known.iter().flatten().count() >= 2;
    Ok(enough.then_some(Earlier { scene, known }))
}

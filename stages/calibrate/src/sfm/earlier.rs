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

/// Reads the earlier scene, if one is connected and has at least two photos of this set.
pub(super) fn load(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[InputPhoto],
    input: &MapperInput<'_>,
) -> Result<Option<Earlier>, StageError> {
    let Some(digest) = inputs.optional(marf_stage::EARLIER) else {
        return Ok(None);
    };
    let scene = Scene::decode(&ctx.get(digest)?)
        .map_err(|error| StageError::new(format!("the earlier scene: {error}")))?;
    let known = items.iter().enumerate().map(|(photo, item)| {
        let id = &item.id;
        let found = scene.frames.binary_search_by(|frame| frame.id.cmp(id)).ok()?;
        let frame = &scene.frames[found];
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

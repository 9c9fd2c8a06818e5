use marf_scene::{Camera, Pose, Scene};
use marf_stage::{Ctx, Inputs, StageError};

use crate::align::{Tolerance, align};
use crate::mapper::{FINE, MapError, Model, Task, grow_from, settle};
use crate::metric::transform;
use crate::photos::Item;

/// A scene of an earlier run that new photos are added to.
pub(super) struct Earlier {
    pub scene: Scene,
    /// Pose and working-size camera of each photo that was in it.
    known: Vec<Option<(Pose, Camera)>>,
}

/// Reads the earlier scene, if one is connected and holds photos of this set.
pub(super) fn load(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[Item],
    task: &Task<'_>,
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
        let size = &task.cameras[task.views[photo].camera].camera;
        Some((
            frame.cam_from_world,
            frame.camera.resized(size.width, size.height),
        ))
    });
    let known: Vec<_> = known.collect();
    let enough = known.iter().flatten().count() >= 2;
    Ok(enough.then_some(Earlier { scene, known }))
}

impl Earlier {
    /// Holds the earlier poses while new photos are added, adjusts all, and moves the answer back so that the
    /// world of the earlier scene stays.
    pub(super) fn extend(&self, task: &Task<'_>) -> Result<Vec<Model>, MapError> {
        let known = |photo: usize| self.known[photo].as_ref();
        let Some(anchor) = (0..self.known.len()).find(|&photo| known(photo).is_some()) else {
            return Ok(Vec::new());
        };
        let mut model = Model::empty(task, anchor);
        for photo in 0..self.known.len() {
            if let Some((pose, camera)) = known(photo) {
                model.poses[photo] = Some(*pose);
                model.cameras[task.views[photo].camera] = *camera;
            }
        }
        model.keep_lens();
        model.complete(task, task.tracks.all());
        let mut model = grow_from(task, model)?;
        settle(task, &mut model, &[], FINE)?;
        self.move_back(&mut model);
        Ok(vec![model])
    }

    fn move_back(&self, model: &mut Model) {
        let pairs: Vec<(Pose, Pose)> = (model.poses.iter().zip(&self.known))
            .filter_map(|(now, before)| Some(((*now)?, before.as_ref()?.0)))
            .collect();
        let any = Tolerance {
            distance: f64::INFINITY,
            angle_rad: f64::INFINITY,
        };
        if let Some(aligned) = align(&pairs, &any) {
            transform(model, &aligned.similarity);
        }
    }
}

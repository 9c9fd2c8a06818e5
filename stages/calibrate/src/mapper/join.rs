use marf_scene::Pose;

use super::refine::{ROUGH, settle};
use super::{MIN_PHOTOS, MapError, Model, Task};
use crate::align::{Tolerance, align};

/// Models are joined if the photos they share agree this well, of the extent of these photos.
const MAX_SHARE: f64 = 0.05;
const MAX_TURN_RAD: f64 = 0.05;

/// Joins the last model to an earlier one that shares photos with it; photos that stay in both are taken from
/// the last.
pub(crate) fn join(task: &Task<'_>, mut models: Vec<Model>) -> Result<Vec<Model>, MapError> {
    let Some(mut last) = models.pop() else {
        return Ok(models);
    };
    for earlier in &mut models {
        let shared: Vec<usize> = last
            .photos()
            .filter(|&photo| earlier.poses[photo].is_some())
            .collect();
        if let Some(joined) = joined(task, earlier, &last, &shared)? {
            *earlier = joined;
            return Ok(models);
        }
        for photo in shared {
            last.remove(task, photo);
        }
    }
    last.filter(task, task.tracks.all());
    if last.photos().count() >= MIN_PHOTOS.min(task.views.len()) {
        settle(task, &mut last, &[], ROUGH)?;
        models.push(last);
    }
    Ok(models)
}

fn joined(
    task: &Task<'_>,
    earlier: &Model,
    last: &Model,
    shared: &[usize],
) -> Result<Option<Model>, MapError> {
    let pairs: Vec<(Pose, Pose)> = shared
        .iter()
        .filter_map(|&photo| Some((last.poses[photo]?, earlier.poses[photo]?)))
        .collect();
    let extent = extent(&pairs);
    let tolerance = Tolerance {
        distance: MAX_SHARE * extent,
        angle_rad: MAX_TURN_RAD,
    };
    let Some(aligned) = align(&pairs, &tolerance) else {
        return Ok(None);
    };
    if pairs.len() < MIN_PHOTOS || aligned.inliers.len() < pairs.len() {
        return Ok(None);
    }
    let mut joined = earlier.clone();
    for (photo, pose) in last.poses.iter().enumerate() {
        if let (None, Some(pose)) = (joined.poses[photo], pose) {
            joined.poses[photo] = Some(aligned.similarity.pose(pose));
        }
    }
    let before = joined.photos().count();
    joined.complete(task, task.tracks.all());
    settle(task, &mut joined, &[], ROUGH)?;
    Ok((joined.photos().count() == before).then_some(joined))
}

/// Largest distance of a centre from the first.
fn extent(pairs: &[(Pose, Pose)]) -> f64 {
    let centres: Vec<_> = pairs.iter().map(|(_, to)| to.centre()).collect();
    let distances = centres.iter().map(|centre| (centre - centres[0]).norm());
    distances.fold(0.0, f64::max)
}

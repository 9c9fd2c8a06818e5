//! Merging of models that share photos.

use super::global_adjustment::{COARSE, refine};
use super::input::{MIN_PHOTOS, MapError, MapperInput};
use super::model::Model;
use crate::align::{PosePair, Tolerance, align};

/// Largest distance between centres of shared photos, as a fraction of the extent of these photos, and largest angle.
const MAX_SHARE: f64 = 0.05;
const MAX_ANGLE_RAD: f64 = 0.05;

/// Merges the last model into an earlier one that shares photos with it. If that fails, removes shared photos from
/// the last.
pub(crate) fn merge_last(input: &MapperInput<'_>, mut models: Vec<Model>) -> Result<Vec<Model>, MapError> {
    let Some(mut last) = models.pop() else {
        return Ok(models);
    };
    for earlier in &mut models {
        let shared: Vec<usize> = last
            .photos()
            .filter(|&photo| earlier.poses[photo].is_some())
            .collect();
        if let Some(merged) = merged(input, earlier, &last, &shared)? {
            *earlier = merged;
            return Ok(models);
        }
        for photo in shared {
            last.remove(input, photo);
        }
    }
    last.filter(input, input.tracks.all());
    if last.photos().count() >= MIN_PHOTOS.min(input.views.len()) {
        refine(input, &mut last, &[], COARSE)?;
        models.push(last);
    }
    Ok(models)
}

/// Returns both models as one, if all photos they share agree.
fn merged(
    input: &MapperInput<'_>,
    earlier: &Model,
    last: &Model,
    shared: &[usize],
) -> Result<Option<Model>, MapError> {
    let pairs = shared.iter().filter_map(|&photo| {
        Some(PosePair {
            cam_from_source: last.poses[photo]?,
            cam_from_target: earlier.poses[photo]?,
        })
    });
    let pairs: Vec<PosePair> = pairs.collect();
    let extent = extent(&pairs);
    let tolerance = Tolerance {
        distance: MAX_SHARE * extent,
        angle_rad: MAX_ANGLE_RAD,
    };
    let Some(alignment) = align(&pairs, &tolerance) else {
        return Ok(None);
    };
    if pairs.len() < MIN_PHOTOS || alignment.inliers.len() < pairs.len() {
        return Ok(None);
    }
    let mut merged = earlier.clone();
    for (photo, pose) in last.poses.iter().enumerate() {
        if let (None, Some(pose)) = (merged.poses[photo], pose) {
            merged.poses[photo] = Some(alignment.similarity.pose(pose));
        }
    }
    let before = merged.photos().count();
    merged.complete(input, input.tracks.all());
    refine(input, &mut merged, &[], COARSE)?;
    Ok((merged.photos().count() == before).then_some(merged))
}

/// Returns the largest distance of a centre from the first.
fn extent(pairs: &[PosePair]) -> f64 {
    let centres: Vec<_> = pairs.iter().map(|pair| pair.cam_from_target.centre()).collect();
    let distances = centres.iter().map(|centre| (centre - centres[0]).norm());
    distances.fold(0.0, f64::max)
}

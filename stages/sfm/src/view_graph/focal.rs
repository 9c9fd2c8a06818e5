//! Focal lengths that are not known, from the verified pairs.

use marf_numeric::upper_median;
use marf_scene::Camera;
use marf_sfm_features::two_view::{FocalKnown, focal_from_pairs};

use super::view::{ComparedPair, SharedCamera, View};

/// Replaces guessed focal lengths by those that the pairs of a camera's photos determine. Otherwise takes the median
/// of those found for other cameras, relative to the longer side: mostly they are one camera, held upright or
/// reduced.
pub fn refine_focal_lengths(cameras: &mut [SharedCamera], views: &[View], pairs: &[ComparedPair]) {
    let mut open = Vec::new();
    let mut found = Vec::new();
    for (index, shared) in cameras.iter_mut().enumerate() {
        if shared.focal == FocalKnown::Known {
            continue;
        }
        let own = pairs
            .iter()
            .filter(|pair| pair.photos.iter().all(|&photo| views[photo].camera == index));
        let fundamentals: Vec<_> = own
            .filter_map(|pair| Some((pair.verified.fundamental?, pair.verified.inliers.len())))
            .collect();
        let side = longer_side(&shared.camera);
        match focal_from_pairs(&fundamentals, &shared.camera) {
            Some(focal_px) => {
                (shared.camera.fx_px, shared.camera.fy_px) = (focal_px, focal_px);
                found.push(focal_px / side);
            }
            None => open.push(index),
        }
    }
    let Some(share) = upper_median(found) else {
        return;
    };
    for index in open {
        let camera = &mut cameras[index].camera;
        let focal_px = share * longer_side(camera);
        (camera.fx_px, camera.fy_px) = (focal_px, focal_px);
    }
}

fn longer_side(camera: &Camera) -> f64 {
    f64::from(camera.width.max(camera.height))
}

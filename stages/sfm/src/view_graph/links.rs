//! Edges of the view graph from verified pairs.

use marf_sfm_features::two_view::{ViewPoints, estimate_relative_pose};

use super::view::{ComparedPair, Link, SharedCamera, View, focal_known, max_error_px};

/// Returns the edge of a pair. `None` if it has no relative pose with at least `min_inliers` inliers.
///
/// `seed`, that of its random samples, must depend on that pair alone.
pub fn link_pair(
    views: &[View],
    cameras: &[SharedCamera],
    pair: &ComparedPair,
    min_inliers: usize,
    seed: u64,
) -> Option<Link> {
    let points = |photo: usize| ViewPoints {
        camera: &cameras[views[photo].camera].camera,
        pixels: &views[photo].pixels,
    };
    let [a, b] = pair.photos;
    let inliers = &pair.verified.inliers;
    if inliers.len() < min_inliers {
        return None;
    }
    let error_px = max_error_px(points(a).camera);
    let focal = focal_known(views, cameras, pair.photos);
    let relative_pose = estimate_relative_pose([&points(a), &points(b)], inliers, focal, error_px, seed)?;
    (relative_pose.inliers.len() >= min_inliers).then_some(Link {
        photos: pair.photos,
        relative_pose,
    })
}

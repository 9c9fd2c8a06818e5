//! Edges of the view graph from verified pairs.

use rayon::prelude::*;

use super::view::{ComparedPair, Link, SharedCamera, View, focal_known, max_error_px};
use crate::two_view::{ViewPoints, estimate_relative_pose};

/// Returns the edges of the pairs that have a relative pose with at least `min_inliers` inliers.
///
/// `seed` returns the seed of the random samples of a pair; it must depend on that pair alone.
pub fn link_pairs(
    views: &[View],
    cameras: &[SharedCamera],
    pairs: &[ComparedPair],
    min_inliers: usize,
    seed: impl Fn(&ComparedPair) -> u64 + Sync,
) -> Vec<Link> {
    let link = |pair: &ComparedPair| {
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
        let relative_pose =
            estimate_relative_pose(&points(a), &points(b), inliers, focal, error_px, seed(pair))?;
        (relative_pose.inliers.len() >= min_inliers).then_some(Link {
            photos: pair.photos,
            relative_pose,
        })
    };
    let links: Vec<Option<Link>> = pairs.par_iter().map(link).collect();
    links.into_iter().flatten().collect()
}

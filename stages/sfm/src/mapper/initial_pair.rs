//! The pair of photos that a model starts from.

use marf_numeric::upper_median;
use marf_scene::Pose;
use marf_sfm_features::estimators::ray_angle_rad;
use marf_sfm_features::two_view::RelativePoseKind;

use super::global_adjustment::{FINE, adjust_all};
use super::input::{MapError, MapperInput};
use super::model::Model;
use crate::view_graph::Link;

/// Thresholds for an initial pair.
struct InitialPairThresholds {
    angle_deg: f64,
    inliers: usize,
    /// Largest part of the motion along the optical axis: depth near the epipole is uncertain.
    forward: f64,
}

/// From strict to loose (COLMAP requires 16 degrees, 100 inliers and 0.95).
const THRESHOLDS: [InitialPairThresholds; 7] = [
    InitialPairThresholds {
        angle_deg: 16.0,
        inliers: 100,
        forward: 0.95,
    },
    InitialPairThresholds {
        angle_deg: 8.0,
        inliers: 100,
        forward: 0.95,
    },
    InitialPairThresholds {
        angle_deg: 4.0,
        inliers: 100,
        forward: 0.95,
    },
    InitialPairThresholds {
        angle_deg: 4.0,
        inliers: 50,
        forward: 1.0,
    },
    InitialPairThresholds {
        angle_deg: 2.0,
        inliers: 50,
        forward: 1.0,
    },
    InitialPairThresholds {
        angle_deg: 2.0,
        inliers: 20,
        forward: 1.0,
    },
    InitialPairThresholds {
        angle_deg: 1.0,
        inliers: 20,
        forward: 1.0,
    },
];
/// Candidates tried for each set of thresholds.
const TRIES: usize = 6;
/// Smallest number of points of an initial model, as a share of the inliers.
const POINT_SHARE: f64 = 0.4;

/// Returns the links between photos not taken that may start a model, best first.
pub(super) fn candidates<'a>(input: &'a MapperInput<'_>, taken: &[bool]) -> Vec<&'a Link> {
    let free = |link: &&Link| link.photos.iter().all(|&photo| !taken[photo]);
    let usable = |link: &&Link| link.relative_pose.kind != RelativePoseKind::Rotation;
    let mut links: Vec<&Link> = input.links.iter().filter(free).filter(usable).collect();
    links.sort_by_key(|link| (std::cmp::Reverse(link.relative_pose.inliers.len()), link.photos));
    let mut chosen: Vec<&Link> = Vec::new();
    for thresholds in &THRESHOLDS {
        let fits = links.iter().filter(|link| thresholds.met_by(link));
        let fresh: Vec<&Link> = fits
            .filter(|link| !chosen.iter().any(|old| old.photos == link.photos))
            .take(TRIES)
            .copied()
            .collect();
        chosen.extend(fresh);
    }
    chosen
}

impl InitialPairThresholds {
    /// Whether a link satisfies the thresholds.
    fn met_by(&self, link: &Link) -> bool {
        let relative_pose = &link.relative_pose;
        relative_pose.median_angle_rad >= self.angle_deg.to_radians()
            && relative_pose.inliers.len() >= self.inliers
            && relative_pose.forward <= self.forward
    }
}

/// Returns a model of two photos. `None` if it has too few points or too little parallax.
pub(super) fn initial_model(input: &MapperInput<'_>, link: &Link) -> Result<Option<Model>, MapError> {
    let [first, second] = link.photos;
    let mut model = Model::empty(input, first);
    model.poses[first] = Some(Pose::identity());
    model.poses[second] = Some(link.relative_pose.cam2_from_cam1);
    let tracks = input.tracks.of_photos(&link.photos);
    model.complete(input, tracks.clone());
    if !is_good(input, &model, link) {
        return Ok(None);
    }
    adjust_all(input, &mut model, &[], FINE)?;
    model.filter(input, tracks.clone());
    model.complete(input, tracks.clone());
    model.filter(input, tracks);
    Ok(is_good(input, &model, link).then_some(model))
}

/// Whether a model of two photos has enough points and parallax.
fn is_good(input: &MapperInput<'_>, model: &Model, link: &Link) -> bool {
    let centres: Vec<_> = model.poses.iter().flatten().map(Pose::centre).collect();
    let [first, second] = centres[..] else {
        return false;
    };
    let points: Vec<_> = model.points.iter().flatten().collect();
    let needed = (POINT_SHARE * link.relative_pose.inliers.len() as f64) as usize;
    let angles = points.iter().map(|point| ray_angle_rad(&first, &second, point));
    let median = upper_median(angles).unwrap_or(0.0);
    points.len() >= needed.max(15) && median >= input.options.min_angle_rad / 2.0
}

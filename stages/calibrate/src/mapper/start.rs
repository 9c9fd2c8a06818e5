use marf_scene::Pose;

use super::{Link, MapError, Model, Task};
use crate::estimators::ray_angle_rad;
use crate::two_view::RelationKind;

use super::refine::{FINE, adjust_all};

/// What a first pair must offer.
struct Demand {
    angle_deg: f64,
    inliers: usize,
    /// Largest share of the motion along the view: the depth around the epipole is weak.
    forward: f64,
}

/// From what makes a good start to what may just work (COLMAP asks 16 degrees, 100 inliers and .95).
const LADDER: [Demand; 7] = [
    Demand {
        angle_deg: 16.0,
        inliers: 100,
        forward: 0.95,
    },
    Demand {
        angle_deg: 8.0,
        inliers: 100,
        forward: 0.95,
    },
    Demand {
        angle_deg: 4.0,
        inliers: 100,
        forward: 0.95,
    },
    Demand {
        angle_deg: 4.0,
        inliers: 50,
        forward: 1.0,
    },
    Demand {
        angle_deg: 2.0,
        inliers: 50,
        forward: 1.0,
    },
    Demand {
        angle_deg: 2.0,
        inliers: 20,
        forward: 1.0,
    },
    Demand {
        angle_deg: 1.0,
        inliers: 20,
        forward: 1.0,
    },
];
/// Candidates tried on each rung.
const TRIES: usize = 6;
/// Points a start must have, as a share of the inliers.
const POINT_SHARE: f64 = 0.4;

/// Links that may start a model among photos not yet taken, best first, each once.
pub(super) fn candidates<'a>(task: &'a Task<'_>, taken: &[bool]) -> Vec<&'a Link> {
    let free = |link: &&Link| link.photos.iter().all(|&photo| !taken[photo]);
    let usable = |link: &&Link| link.relation.kind != RelationKind::Rotation;
    let mut links: Vec<&Link> = task.links.iter().filter(free).filter(usable).collect();
    links.sort_by_key(|link| (std::cmp::Reverse(link.relation.inliers.len()), link.photos));
    let mut chosen: Vec<&Link> = Vec::new();
    for demand in &LADDER {
        let fits = links.iter().filter(|link| demand.met_by(link));
        let fresh: Vec<&Link> = fits
            .filter(|link| !chosen.iter().any(|old| old.photos == link.photos))
            .take(TRIES)
            .copied()
            .collect();
        chosen.extend(fresh);
    }
    chosen
}

impl Demand {
    fn met_by(&self, link: &Link) -> bool {
        let relation = &link.relation;
        relation.median_angle_rad >= self.angle_deg.to_radians()
            && relation.inliers.len() >= self.inliers
            && relation.forward <= self.forward
    }
}

/// A model of two photos; `None` if they do not hold together.
pub(super) fn start(task: &Task<'_>, link: &Link) -> Result<Option<Model>, MapError> {
    let [first, second] = link.photos;
    let mut model = Model::empty(task, first);
    model.poses[first] = Some(Pose::identity());
    model.poses[second] = Some(link.relation.cam2_from_cam1);
    let tracks = task.tracks.of_photos(&link.photos);
    model.complete(task, tracks.clone());
    if !holds(task, &model, link) {
        return Ok(None);
    }
    adjust_all(task, &mut model, &[], FINE)?;
    model.filter(task, tracks.clone());
    model.complete(task, tracks.clone());
    model.filter(task, tracks);
    Ok(holds(task, &model, link).then_some(model))
}

/// Enough points, seen under an angle not far below what the link promised.
fn holds(task: &Task<'_>, model: &Model, link: &Link) -> bool {
    let centres: Vec<_> = model.poses.iter().flatten().map(Pose::centre).collect();
    let [first, second] = centres[..] else {
        return false;
    };
    let mut angles: Vec<f64> = model
        .points
        .iter()
        .flatten()
        .map(|point| ray_angle_rad(&first, &second, point))
        .collect();
    angles.sort_by(f64::total_cmp);
    let needed = (POINT_SHARE * link.relation.inliers.len() as f64) as usize;
    let median = angles.get(angles.len() / 2).copied().unwrap_or(0.0);
    angles.len() >= needed.max(15) && median >= task.options.min_angle_rad / 2.0
}

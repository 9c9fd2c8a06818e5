//! VerifiedPair matches and focal lengths in, a relative pose out.

use marf_numeric::{Rng, upper_median};
use marf_scene::Pose;
use nalgebra::{Matrix3, Vector3};

use super::correspondences::{Correspondences, focal_px};
use super::pure_rotation::{fit_rotation_and_focal, fit_scale_and_shift};
use super::ray_matches::RayMatches;
use super::types::{FocalKnown, RelativePose, RelativePoseKind, ViewPoints};
use super::verify::PLANAR_SHARE;
use crate::estimators::{
    Consensus, EpipolarModel, InvertibleHomography, PointPair, RansacOptions, cross_matrix, depths,
    essential_of, five_point, locally_optimised, pose_of_essential, poses_from_homography, ransac_homography,
    rotation_between, sampson2, scored_if_better, transfer2,
};

/// Verified matches are mostly right: a hundred samples reach a share of 0.4 of five.
const RANSAC: RansacOptions = RansacOptions {
    max_samples: 500,
    confidence: 0.9999,
    min_inliers: MIN_INLIERS,
};

/// Fewest inliers of a relative pose: five always fit.
const MIN_INLIERS: usize = 6;

/// Damped steps of a refinement inside the search, and of the last one.
const QUICK_STEPS: usize = 3;
const LAST_STEPS: usize = 10;

/// Largest median angle of a pure rotation (1 degree).
const ROTATION_ANGLE_RAD: f64 = 0.017_453_292_519_943_295;
/// Smallest share of the inliers of the relative pose that fit a pure rotation.
const ROTATION_SHARE: f64 = 0.8;
/// Largest residual variance of a pure rotation, as a multiple of that of the essential matrix.
const ROTATION_VARIANCE: f64 = 3.0;
/// Lower bound of the latter, (0.1 px)²: features are not more accurate.
const MIN_VARIANCE: f64 = 0.01;

/// A pure rotation and its inliers.
type PureRotation = (Matrix3<f64>, Vec<usize>);

/// A candidate: an essential matrix and the pose it decomposes into.
#[derive(Clone)]
struct Candidate {
    essential: Matrix3<f64>,
    pose: Pose,
}

/// Returns the relative pose of two photos from verified matches, with the focal lengths of their cameras.
///
/// Candidates: LO-RANSAC over five points, the two poses that the homography decomposes into, the best pure rotation
/// with three directions of translation. Each is refined, points behind a camera count as outliers, and the one of
/// lowest cost is kept. An exact plane may leave two poses whose costs differ by less than four mean residuals. By
/// convention, the one with the smaller rotation is then returned, and `kind` is `Planar`.
///
/// `Rotation` if the median angle is below 1 deg, a pure rotation has at least 0.8 of the inliers, and its residual
/// variance on those is at most 3 times that of the essential matrix. Parallax below about twice the noise cannot be
/// distinguished from none. The same test is applied to a crop or zoom of one image, and to a rotation with another
/// focal length where this one is a guess. Each resembles a camera that moves past a plane. `None` with fewer than 6
/// inliers.
pub fn estimate_relative_pose(
    views: [&ViewPoints<'_>; 2],
    inliers: &[[u32; 2]],
    focal: FocalKnown,
    max_error_px: f64,
    seed: u64,
) -> Option<RelativePose> {
    let correspondences = Correspondences::new(views, inliers);
    let noise2 = views.map(|view| 1.0 / (focal_px(view.camera) * focal_px(view.camera)));
    let matches = Estimation(RayMatches {
        pairs: &correspondences.planes,
        noise2,
        limit: max_error_px,
    });
    let mut rng = Rng::new(seed);
    let sampled = matches.essential(&mut rng);
    let rotation = matches.rotation(&mut rng);
    let plane = matches.homography(&mut rng);
    let candidates = matches.candidates(sampled, plane.as_ref(), rotation.as_ref());
    let best = matches.of_lowest_cost(candidates)?;
    let agreed = best.inliers.len();
    let homography_share = plane
        .as_ref()
        .map_or(0.0, |plane| (plane.inliers.len() as f64 / agreed as f64).min(1.0));
    let pick = |indices: &[usize]| {
        indices
            .iter()
            .map(|&i| correspondences.matches[i])
            .collect::<Vec<_>>()
    };
    let median_angle_rad = matches.median_angle_rad(&best);
    let planar = homography_share > PLANAR_SHARE;
    let rotation = rotation.filter(|_| median_angle_rad <= ROTATION_ANGLE_RAD);
    let pure = rotation.and_then(|rotation| matches.without_baseline(&best, &rotation));
    let plane = plane.filter(|_| planar);
    let degenerate = || matches.degenerate(&best, &plane?.inliers, focal, views[0]);
    if let Some((rotation, held)) = pure.or_else(degenerate) {
        return Some(RelativePose {
            kind: RelativePoseKind::Rotation,
            cam2_from_cam1: Pose {
                rotation,
                translation: Vector3::zeros(),
            },
            inliers: pick(&held),
            median_angle_rad,
            forward: 0.0,
        });
    }
    Some(RelativePose {
        kind: if planar {
            RelativePoseKind::Planar
        } else {
            RelativePoseKind::General
        },
        cam2_from_cam1: best.model.pose,
        inliers: pick(&best.inliers),
        median_angle_rad,
        forward: best.model.pose.translation.z.abs(),
    })
}

/// The estimation of a relative pose from matches.
struct Estimation<'a>(RayMatches<'a>);

impl Estimation<'_> {
    /// Returns the inliers of the matches.
    fn agreed<'a>(&'a self, inliers: &'a [usize]) -> impl Iterator<Item = &'a PointPair> + Clone {
        inliers.iter().map(|&i| &self.0.pairs[i])
    }

    /// Returns the options of a search for a rotation or a homography, which matters only with half of the matches.
    fn at_least_half(&self) -> RansacOptions {
        RansacOptions {
            min_inliers: MIN_INLIERS.max(self.0.pairs.len() / 2),
            ..RANSAC
        }
    }

    /// Returns the squared Sampson error over the squared limit.
    fn epipolar_error(&self, essential: &Matrix3<f64>, i: usize) -> f64 {
        sampson2(essential, &self.0.pairs[i], self.0.noise2) / (self.0.limit * self.0.limit)
    }

    /// Returns an essential matrix refined on its inliers.
    fn refined(&self, essential: &Matrix3<f64>, inliers: &[usize], steps: usize) -> Option<Matrix3<f64>> {
        let (agreed, scale) = (self.agreed(inliers), self.0.limit / 2.0);
        (inliers.len() >= MIN_INLIERS)
            .then(|| EpipolarModel::Essential.refined(essential, agreed, self.0.noise2, scale, steps))
            .flatten()
    }

    /// Returns the essential matrix with the largest consensus.
    fn essential(&self, rng: &mut Rng) -> Option<Consensus<Matrix3<f64>>> {
        let solve = |sample: &[usize; 5]| {
            let side = |side: usize| sample.map(|i| self.0.pairs[i][side]);
            five_point(&side(0), &side(1))
        };
        let improve = |e: &Matrix3<f64>, inliers: &[usize]| self.refined(e, inliers, QUICK_STEPS);
        RANSAC.lo_ransac(
            self.0.pairs.len(),
            rng,
            solve,
            |e, i| self.epipolar_error(e, i),
            improve,
        )
    }

    /// Returns the squared error of a pure rotation in photo 2, in units of the limit.
    fn rotation_error(&self, rotation: &Matrix3<f64>, i: usize) -> f64 {
        let [p, q] = &self.0.pairs[i];
        let carried = rotation * p.push(1.0);
        let distance2 = transfer2(rotation, p, q) / (self.0.noise2[1] * self.0.limit * self.0.limit);
        if carried.z > 0.0 { distance2 } else { f64::INFINITY }
    }

    /// Returns the pure rotation with the largest consensus.
    fn rotation(&self, rng: &mut Rng) -> Option<Consensus<Matrix3<f64>>> {
        let rays = |i: usize| {
            let [p, q] = &self.0.pairs[i];
            (p.push(1.0).normalize(), q.push(1.0).normalize(), 1.0)
        };
        let solve = |sample: &[usize; 2]| vec![rotation_between(sample.iter().map(|&i| rays(i)))];
        let improve =
            |_: &Matrix3<f64>, inliers: &[usize]| Some(rotation_between(inliers.iter().map(|&i| rays(i))));
        self.at_least_half().lo_ransac(
            self.0.pairs.len(),
            rng,
            solve,
            |rotation, i| self.rotation_error(rotation, i),
            improve,
        )
    }

    /// Returns the homography with the largest consensus.
    fn homography(&self, rng: &mut Rng) -> Option<Consensus<InvertibleHomography>> {
        ransac_homography(
            self.0.pairs,
            self.0.noise2,
            self.0.limit,
            &self.at_least_half(),
            rng,
        )
    }

    /// Returns the essential matrices to compare, those of planes first, the smaller rotation before the other.
    fn candidates(
        &self,
        sampled: Option<Consensus<Matrix3<f64>>>,
        plane: Option<&Consensus<InvertibleHomography>>,
        rotation: Option<&Consensus<Matrix3<f64>>>,
    ) -> Vec<Matrix3<f64>> {
        let half = self.0.pairs.len() / 2;
        let mut candidates = Vec::new();
        if let Some(plane) = plane.filter(|plane| plane.inliers.len() > half) {
            let on_plane: Vec<PointPair> = self.agreed(&plane.inliers).copied().collect();
            let motions = poses_from_homography(&plane.model[0], &on_plane);
            candidates.extend(motions.iter().map(essential_of));
        }
        candidates.extend(sampled.map(|found| found.model));
        if let Some(rotation) = rotation.filter(|rotation| rotation.inliers.len() > half) {
            let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
            candidates.extend(axes.map(|axis| cross_matrix(&axis) * rotation.model));
        }
        candidates
    }

    /// Returns the refined candidate of lowest cost. A later one must be better by four mean residuals.
    fn of_lowest_cost(&self, candidates: Vec<Matrix3<f64>>) -> Option<Consensus<Candidate>> {
        let mut best: Option<Consensus<Candidate>> = None;
        for candidate in candidates {
            let Some(found) = self.refined_candidate(candidate) else {
                continue;
            };
            let margin = 4.0 * found.cost / self.0.pairs.len() as f64 + 1e-9;
            if best.as_ref().is_none_or(|best| found.cost + margin < best.cost) {
                best = Some(found);
            }
        }
        best.filter(|best| best.inliers.len() >= MIN_INLIERS)
    }

    /// Returns a candidate refined on its own inliers, with its pose, and its consensus with points behind a camera as
    /// outliers.
    fn refined_candidate(&self, essential: Matrix3<f64>) -> Option<Consensus<Candidate>> {
        let count = self.0.pairs.len();
        let error2 = |e: &Matrix3<f64>, i: usize| self.epipolar_error(e, i);
        let improve = |e: &Matrix3<f64>, inliers: &[usize]| self.refined(e, inliers, LAST_STEPS);
        let found = locally_optimised(
            scored_if_better(essential, count, None, &error2)?,
            count,
            &error2,
            &improve,
        );
        let (pose, _) = pose_of_essential(&found.model, self.agreed(&found.inliers));
        let candidate = Candidate {
            essential: found.model,
            pose,
        };
        scored_if_better(candidate, count, None, &|candidate: &Candidate, i: usize| {
            let error2 = self.epipolar_error(&candidate.essential, i);
            if self.behind(&candidate.pose, i) {
                f64::INFINITY
            } else {
                error2
            }
        })
    }

    /// Whether the rays of a match intersect behind a camera, by more than the error may cause.
    fn behind(&self, pose: &Pose, i: usize) -> bool {
        let (depth_1, depth_2) = depths(pose, &self.0.pairs[i]);
        let doubt = self.0.limit * self.0.noise2[0].max(self.0.noise2[1]).sqrt();
        !(depth_1 > 0.0 && depth_2 > 0.0) && angle_rad(pose, &self.0.pairs[i]) > doubt
    }

    /// Returns the median triangulation angle of the inliers.
    fn median_angle_rad(&self, found: &Consensus<Candidate>) -> f64 {
        let angles = self
            .agreed(&found.inliers)
            .map(|pair| angle_rad(&found.model.pose, pair));
        upper_median(angles).unwrap_or(0.0)
    }

    /// Returns a pure rotation that explains the inliers of a candidate.
    fn without_baseline(
        &self,
        found: &Consensus<Candidate>,
        rotation: &Consensus<Matrix3<f64>>,
    ) -> Option<PureRotation> {
        let spread = 1.0 + self.0.noise2[0] / self.0.noise2[1];
        let held =
            self.inliers_without_parallax(found, |i| self.rotation_error(&rotation.model, i) / spread, 3.0)?;
        Some((rotation.model, held))
    }

    /// Returns the rotation of a pair that only resembles a camera that moves past a plane: one image cropped or
    /// zoomed, or a rotation with another focal length. `on`: the inliers of the homography, without wrong matches
    /// along an epipolar line.
    fn degenerate(
        &self,
        found: &Consensus<Candidate>,
        on: &[usize],
        focal: FocalKnown,
        view: &ViewPoints,
    ) -> Option<PureRotation> {
        let cropped = fit_scale_and_shift(&self.0, on)
            .and_then(|map| self.inliers_without_parallax(found, |i| map.error2(&self.0, i), 3.0));
        if let Some(held) = cropped {
            return Some((Matrix3::identity(), held));
        }
        let map = (focal == FocalKnown::Guessed)
            .then(|| fit_rotation_and_focal(&self.0, on, view.camera))
            .flatten()?;
        let held = self.inliers_without_parallax(found, |i| map.error2(&self.0, i), 4.0)?;
        Some((map.rotation, held))
    }

    /// Returns the inliers of a candidate that also fit a mapping without parallax, if they are nearly all and their errors
    /// are not much larger.
    ///
    /// `error2`: squared distance per unit of its own variance, in units of the limit.
    fn inliers_without_parallax(
        &self,
        found: &Consensus<Candidate>,
        error2: impl Fn(usize) -> f64,
        parameters: f64,
    ) -> Option<Vec<usize>> {
        let fits = |i: &usize| error2(*i) <= 1.0;
        let held: Vec<usize> = found.inliers.iter().copied().filter(fits).collect();
        let count = held.len() as f64;
        if count < ROTATION_SHARE * found.inliers.len() as f64 {
            return None;
        }
        let limit2 = self.0.limit * self.0.limit;
        let sum = |error: &dyn Fn(usize) -> f64| held.iter().map(|&i| error(i)).sum::<f64>() * limit2;
        // A mapping has two residuals a match, an essential matrix one and five parameters.
        let of_map = sum(&error2) / (2.0 * count - parameters);
        let of_candidate = sum(&|i| self.epipolar_error(&found.model.essential, i)) / (count - 5.0).max(1.0);
        (of_map <= ROTATION_VARIANCE * of_candidate.max(MIN_VARIANCE)).then_some(held)
    }
}

/// Returns the angle between the two rays of a match.
fn angle_rad(cam2_from_cam1: &Pose, [p, q]: &PointPair) -> f64 {
    let (ray_1, ray_2) = (cam2_from_cam1.rotation * p.push(1.0), q.push(1.0));
    libm::atan2(ray_1.cross(&ray_2).norm(), ray_1.dot(&ray_2))
}

//! Verified matches and focal lengths in, a relative pose out.

use marf_scene::Pose;
use nalgebra::{Matrix3, Vector3};

use super::spots::{Spots, focal_px};
use super::still::{other_focal, same_picture};
use super::verify::PLANAR_SHARE;
use super::{FocalKnown, Relation, RelationKind, ViewPoints};
use crate::dice::Dice;
use crate::estimators::{
    Consensus, Family, Pair, Trials, TwoWay, better, cross_matrix, depths, essential_of, five_point,
    improved, lo_ransac, plane_motions, polish_epipolar, pose_of_essential, sampson2, transfer2,
    turn_between, two_way_homography,
};

/// Verified matches are mostly right: a hundred samples reach a share of .4 of five.
const TRIALS: Trials = Trials {
    most: 500,
    confidence: 0.9999,
    least: LEAST,
};

/// Fewest matches that say anything: five fit always.
const LEAST: usize = 6;

/// Damped steps of a refinement inside the search, and of the last one.
const QUICK_STEPS: usize = 3;
const LAST_STEPS: usize = 10;

/// A turn on the spot: median angle below this,
const TURN_ANGLE_RAD: f64 = 0.017_453_292_519_943_295;
/// the turn alone within the error of this share of the inliers,
const TURN_SHARE: f64 = 0.8;
/// and its residual variance at most this multiple of the essential matrix's own,
const TURN_VARIANCE: f64 = 3.0;
/// which is taken as no less than (.1 px)²: features are not placed better.
const LEAST_VARIANCE: f64 = 0.01;

/// What the fits share: plane points, the squared size of a pixel there, the largest error in pixels.
pub(super) struct Matches<'a> {
    pub pairs: &'a [Pair],
    pub noise2: [f64; 2],
    pub limit: f64,
}

/// A turn and the inliers it holds.
type Still = (Matrix3<f64>, Vec<usize>);

/// A candidate motion: its essential matrix, its pose, and what agrees with both.
#[derive(Clone)]
struct Motion {
    essential: Matrix3<f64>,
    pose: Pose,
}

/// Finds the relative pose of two photos from verified matches, with the focal lengths as the cameras have them.
///
/// Candidates: LO-RANSAC over five points, the two motions behind the homography, the best turn with three
/// directions. Each is polished, its points behind a camera count as outliers, and the cheapest stays. An
/// exact plane may leave two motions that cost the same to within four residuals' worth: then the one that
/// turns less is taken, which is a convention, not knowledge; `kind` is then `Planar`.
///
/// `Rotation` where the median angle is below 1 deg, a pure turn holds at least .8 of the inliers, and its
/// residual variance (on those) is at most 3 times the essential matrix's: parallax of less than about
/// twice the noise is not told from none. By the same measure a crop or a zoom of one picture, and a turn under
/// another focal length where this one is a guess: each looks like a plane that the camera passes.
/// `None` with fewer than 6 inliers.
pub(crate) fn relate(
    a: &ViewPoints,
    b: &ViewPoints,
    inliers: &[[u32; 2]],
    focal: FocalKnown,
    max_error_px: f64,
    seed: u64,
) -> Option<Relation> {
    let spots = Spots::new(a, b, inliers);
    let noise2 = [a, b].map(|view| 1.0 / (focal_px(view.camera) * focal_px(view.camera)));
    let matches = Matches {
        pairs: &spots.planes,
        noise2,
        limit: max_error_px,
    };
    let mut dice = Dice::new(seed);
    let sampled = matches.essential(&mut dice);
    let turn = matches.turn(&mut dice);
    let plane = matches.homography(&mut dice);
    let candidates = matches.candidates(sampled, plane.as_ref(), turn.as_ref());
    let best = matches.cheapest(candidates)?;
    let agreed = best.inliers.len();
    let homography_share = plane
        .as_ref()
        .map_or(0.0, |plane| (plane.inliers.len() as f64 / agreed as f64).min(1.0));
    let pick = |indices: &[usize]| indices.iter().map(|&i| spots.matches[i]).collect::<Vec<_>>();
    let median_angle_rad = matches.median_angle_rad(&best);
    let planar = homography_share > PLANAR_SHARE;
    let turn = turn.filter(|_| median_angle_rad <= TURN_ANGLE_RAD);
    let still = turn.and_then(|turn| matches.turned(&best, &turn));
    let plane = plane.filter(|_| planar);
    let hidden = || matches.hidden(&best, &plane?.inliers, focal, a);
    if let Some((rotation, held)) = still.or_else(hidden) {
        return Some(Relation {
            kind: RelationKind::Rotation,
            cam2_from_cam1: Pose {
                rotation,
                translation: Vector3::zeros(),
            },
            inliers: pick(&held),
            median_angle_rad,
            forward: 0.0,
        });
    }
    Some(Relation {
        kind: if planar {
            RelationKind::Planar
        } else {
            RelationKind::General
        },
        cam2_from_cam1: best.model.pose,
        inliers: pick(&best.inliers),
        median_angle_rad,
        forward: best.model.pose.translation.z.abs(),
    })
}

impl Matches<'_> {
    fn agreed<'a>(&'a self, inliers: &'a [usize]) -> impl Iterator<Item = &'a Pair> + Clone {
        inliers.iter().map(|&i| &self.pairs[i])
    }

    /// A turn or a plane matters only where it holds half of the matches: less is not waited for.
    fn half(&self) -> Trials {
        Trials {
            least: LEAST.max(self.pairs.len() / 2),
            ..TRIALS
        }
    }

    fn epipolar_error(&self, essential: &Matrix3<f64>, i: usize) -> f64 {
        sampson2(essential, &self.pairs[i], self.noise2) / (self.limit * self.limit)
    }

    fn polished(&self, essential: &Matrix3<f64>, inliers: &[usize], steps: usize) -> Option<Matrix3<f64>> {
        let (agreed, scale) = (self.agreed(inliers), self.limit / 2.0);
        (inliers.len() >= LEAST)
            .then(|| polish_epipolar(essential, agreed, self.noise2, scale, Family::Essential, steps))
            .flatten()
    }

    fn essential(&self, dice: &mut Dice) -> Option<Consensus<Matrix3<f64>>> {
        let solve = |sample: &[usize; 5]| {
            let side = |side: usize| sample.map(|i| self.pairs[i][side]);
            five_point(&side(0), &side(1))
        };
        let improve = |e: &Matrix3<f64>, inliers: &[usize]| self.polished(e, inliers, QUICK_STEPS);
        lo_ransac(
            self.pairs.len(),
            &TRIALS,
            dice,
            solve,
            |e, i| self.epipolar_error(e, i),
            improve,
        )
    }

    /// Squared distance in photo 2, in units of the limit.
    fn turn_error(&self, turn: &Matrix3<f64>, i: usize) -> f64 {
        let [p, q] = &self.pairs[i];
        let carried = turn * p.push(1.0);
        let distance2 = transfer2(turn, p, q) / (self.noise2[1] * self.limit * self.limit);
        if carried.z > 0.0 { distance2 } else { f64::INFINITY }
    }

    fn turn(&self, dice: &mut Dice) -> Option<Consensus<Matrix3<f64>>> {
        let rays = |i: usize| {
            let [p, q] = &self.pairs[i];
            (p.push(1.0).normalize(), q.push(1.0).normalize(), 1.0)
        };
        let solve = |sample: &[usize; 2]| vec![turn_between(sample.iter().map(|&i| rays(i)))];
        let improve =
            |_: &Matrix3<f64>, inliers: &[usize]| Some(turn_between(inliers.iter().map(|&i| rays(i))));
        lo_ransac(
            self.pairs.len(),
            &self.half(),
            dice,
            solve,
            |turn, i| self.turn_error(turn, i),
            improve,
        )
    }

    fn homography(&self, dice: &mut Dice) -> Option<Consensus<TwoWay>> {
        two_way_homography(self.pairs, self.noise2, self.limit, &self.half(), dice)
    }

    /// Essential matrices worth comparing, those of planes first, the lesser turn before the other.
    fn candidates(
        &self,
        sampled: Option<Consensus<Matrix3<f64>>>,
        plane: Option<&Consensus<TwoWay>>,
        turn: Option<&Consensus<Matrix3<f64>>>,
    ) -> Vec<Matrix3<f64>> {
        let half = self.pairs.len() / 2;
        let mut candidates = Vec::new();
        if let Some(plane) = plane.filter(|plane| plane.inliers.len() > half) {
            let on_plane: Vec<Pair> = self.agreed(&plane.inliers).copied().collect();
            let motions = plane_motions(&plane.model[0], &on_plane);
            candidates.extend(motions.iter().map(essential_of));
        }
        candidates.extend(sampled.map(|found| found.model));
        if let Some(turn) = turn.filter(|turn| turn.inliers.len() > half) {
            let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
            candidates.extend(axes.map(|axis| cross_matrix(&axis) * turn.model));
        }
        candidates
    }

    /// Polishes all candidates and keeps the cheapest; a later one must win by four mean residuals.
    fn cheapest(&self, candidates: Vec<Matrix3<f64>>) -> Option<Consensus<Motion>> {
        let mut best: Option<Consensus<Motion>> = None;
        for candidate in candidates {
            let Some(found) = self.settled(candidate) else {
                continue;
            };
            let margin = 4.0 * found.cost / self.pairs.len() as f64 + 1e-9;
            if best.as_ref().is_none_or(|best| found.cost + margin < best.cost) {
                best = Some(found);
            }
        }
        best.filter(|best| best.inliers.len() >= LEAST)
    }

    /// Polishes a matrix on its own inliers, finds its pose, and counts again with points behind a camera
    /// as outliers.
    fn settled(&self, essential: Matrix3<f64>) -> Option<Consensus<Motion>> {
        let count = self.pairs.len();
        let error2 = |e: &Matrix3<f64>, i: usize| self.epipolar_error(e, i);
        let improve = |e: &Matrix3<f64>, inliers: &[usize]| self.polished(e, inliers, LAST_STEPS);
        let found = improved(better(essential, count, None, &error2)?, count, &error2, &improve);
        let (pose, _) = pose_of_essential(&found.model, self.agreed(&found.inliers));
        let motion = Motion {
            essential: found.model,
            pose,
        };
        better(motion, count, None, &|motion: &Motion, i: usize| {
            let error2 = self.epipolar_error(&motion.essential, i);
            if self.behind(&motion.pose, i) {
                f64::INFINITY
            } else {
                error2
            }
        })
    }

    /// Tells whether a pair's rays meet behind a camera by more than the error may do.
    fn behind(&self, pose: &Pose, i: usize) -> bool {
        let (depth_1, depth_2) = depths(pose, &self.pairs[i]);
        let doubt = self.limit * self.noise2[0].max(self.noise2[1]).sqrt();
        !(depth_1 > 0.0 && depth_2 > 0.0) && angle_rad(pose, &self.pairs[i]) > doubt
    }

    fn median_angle_rad(&self, found: &Consensus<Motion>) -> f64 {
        let mut angles: Vec<f64> = self
            .agreed(&found.inliers)
            .map(|pair| angle_rad(&found.model.pose, pair))
            .collect();
        angles.sort_by(f64::total_cmp);
        angles.get(angles.len() / 2).copied().unwrap_or(0.0)
    }

    fn turned(&self, found: &Consensus<Motion>, turn: &Consensus<Matrix3<f64>>) -> Option<Still> {
        let spread = 1.0 + self.noise2[0] / self.noise2[1];
        let held = self.held(found, |i| self.turn_error(&turn.model, i) / spread, 3.0)?;
        Some((turn.model, held))
    }

    /// What only looks like a plane that the camera passes: one picture cropped or zoomed, or a turn under
    /// another focal length. `on`: the plane's own inliers; wrong matches along an epipolar line are not among
    /// them.
    fn hidden(
        &self,
        found: &Consensus<Motion>,
        on: &[usize],
        focal: FocalKnown,
        view: &ViewPoints,
    ) -> Option<Still> {
        let cropped = same_picture(self, on).and_then(|map| self.held(found, |i| map.error2(self, i), 3.0));
        if let Some(held) = cropped {
            return Some((Matrix3::identity(), held));
        }
        let map = (focal == FocalKnown::Guessed)
            .then(|| other_focal(self, on, view.camera))
            .flatten()?;
        let held = self.held(found, |i| map.error2(self, i), 4.0)?;
        Some((map.turn, held))
    }

    /// The inliers that a map without parallax holds too, if they are nearly all and err not much more by it.
    ///
    /// `error2`: squared distance per unit of its own variance, in units of the limit.
    fn held(
        &self,
        found: &Consensus<Motion>,
        error2: impl Fn(usize) -> f64,
        freedoms: f64,
    ) -> Option<Vec<usize>> {
        let fits = |i: &usize| error2(*i) <= 1.0;
        let held: Vec<usize> = found.inliers.iter().copied().filter(fits).collect();
        let count = held.len() as f64;
        if count < TURN_SHARE * found.inliers.len() as f64 {
            return None;
        }
        let limit2 = self.limit * self.limit;
        let sum = |error: &dyn Fn(usize) -> f64| held.iter().map(|&i| error(i)).sum::<f64>() * limit2;
        // Two coordinates a match, each with the noise of both photos. And one with five freedoms.
        let of_map = sum(&error2) / (2.0 * count - freedoms);
        let of_motion = sum(&|i| self.epipolar_error(&found.model.essential, i)) / (count - 5.0).max(1.0);
        (of_map <= TURN_VARIANCE * of_motion.max(LEAST_VARIANCE)).then_some(held)
    }
}

/// The angle between the two rays of a pair.
fn angle_rad(cam2_from_cam1: &Pose, [p, q]: &Pair) -> f64 {
    let (ray_1, ray_2) = (cam2_from_cam1.rotation * p.push(1.0), q.push(1.0));
    libm::atan2(ray_1.cross(&ray_2).norm(), ray_1.dot(&ray_2))
}

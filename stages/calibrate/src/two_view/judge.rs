//! The best fundamental matrix, essential matrix and homography of a set of matches.

use marf_scene::Camera;
use nalgebra::{Matrix3, Vector3};

use super::spots::{Spots, centring, focal_px, intrinsics};
use super::{FocalKnown, VerifyOptions};
use crate::dice::Dice;
use crate::estimators::{
    Consensus, Family, Pair, Trials, TwoWay, better, cross_matrix, eight_point, five_point, improved,
    lo_ransac, polish_epipolar, sampson2, seven_point, two_way_homography,
};

/// Damped steps of a refinement inside the search, and of the last one.
const QUICK_STEPS: usize = 3;
const LAST_STEPS: usize = 10;

/// Samples of two points off the plane: at a share of .2 of true ones all miss with chance 3e-4.
const PARALLAX_TRIALS: u32 = 200;

/// Consensus of each model over the same matches.
pub(super) struct Judged {
    /// In ideal pixels.
    pub fundamental: Option<Consensus<Matrix3<f64>>>,
    pub essential: Option<Consensus<Matrix3<f64>>>,
    pub homography: Option<Consensus<TwoWay>>,
}

impl Judged {
    pub(super) fn counts(&self) -> [usize; 3] {
        let count = |found: &Option<Consensus<Matrix3<f64>>>| found.as_ref().map_or(0, |c| c.inliers.len());
        let homography = self.homography.as_ref().map_or(0, |c| c.inliers.len());
        [count(&self.fundamental), count(&self.essential), homography]
    }
}

/// What the searches share.
struct Search<'a> {
    /// Ideal pixels, centred and scaled.
    pairs: Vec<Pair>,
    planes: &'a [Pair],
    /// Largest error, in the unit of `pairs`.
    limit: f64,
    trials: Trials,
}

/// Fits the three models (the essential matrix only with known focal lengths).
///
/// The seven-point search is blind on a plane, so the homography and the essential matrix propose
/// fundamental matrices too (plane and parallax: F = [e]x H, Chum, Werner, Matas, CVPR 2005), and the
/// cheapest stays.
pub(super) fn judge(
    [a, b]: [&Camera; 2],
    spots: &Spots,
    focal: FocalKnown,
    options: &VerifyOptions,
    least: usize,
    dice: &mut Dice,
) -> Judged {
    let unit = 0.5 * f64::from(a.width.max(a.height).max(b.width).max(b.height));
    let to_1 = centring(a, unit) * intrinsics(a);
    let to_2 = centring(b, unit) * intrinsics(b);
    let carried = |to: &Matrix3<f64>, plane: &nalgebra::Vector2<f64>| (to * plane.push(1.0)).xy();
    let pairs = spots
        .planes
        .iter()
        .map(|[p, q]| [carried(&to_1, p), carried(&to_2, q)])
        .collect();
    let trials = Trials {
        most: options.max_trials,
        confidence: options.confidence,
        least,
    };
    let search = Search {
        pairs,
        planes: &spots.planes,
        limit: options.max_error_px / unit,
        trials,
    };
    let homography = search.homography(dice);
    let fundamental = search.fundamental(homography.as_ref(), dice);
    let agreed = |count: Option<usize>| count.is_some_and(|count| count >= least);
    // Where neither finds anything, five points will not: their trials reach the same share of inliers.
    let hopeful = agreed(fundamental.as_ref().map(|found| found.inliers.len()))
        || agreed(homography.as_ref().map(|found| found.inliers.len()));
    let noise2 = [a, b].map(|camera| unit * unit / (focal_px(camera) * focal_px(camera)));
    let essential = (focal == FocalKnown::Known && hopeful)
        .then(|| search.essential(noise2, dice))
        .flatten();
    let proposed = essential
        .as_ref()
        .and_then(|essential| Some(to_2.try_inverse()?.transpose() * essential.model * to_1.try_inverse()?));
    let fundamental = search
        .with_candidate(fundamental, proposed)
        .map(|found| search.last_polish(found));
    let (to_1, to_2) = (centring(a, unit), centring(b, unit));
    let fundamental = fundamental.map(|found| Consensus {
        model: (to_2.transpose() * found.model * to_1).normalize(),
        ..found
    });
    Judged {
        fundamental,
        essential,
        homography,
    }
}

impl Search<'_> {
    fn selected<'a>(from: &'a [Pair], inliers: &'a [usize]) -> impl Iterator<Item = &'a Pair> + Clone {
        inliers.iter().map(|&i| &from[i])
    }

    fn few(&self) -> Trials {
        // Five points in 500 trials reach the share of inliers that seven reach in 2000: .44; four reach
        // .34.
        Trials {
            most: self.trials.most.div_ceil(4),
            ..self.trials
        }
    }

    fn homography(&self, dice: &mut Dice) -> Option<Consensus<TwoWay>> {
        two_way_homography(&self.pairs, [1.0; 2], self.limit, &self.few(), dice)
    }

    /// `noise2`: one unit of `pairs` in plane units, squared; errors come out in that unit.
    fn essential(&self, noise2: [f64; 2], dice: &mut Dice) -> Option<Consensus<Matrix3<f64>>> {
        let solve = |sample: &[usize; 5]| {
            let side = |side: usize| sample.map(|i| self.planes[i][side]);
            five_point(&side(0), &side(1))
        };
        let error2 =
            |e: &Matrix3<f64>, i: usize| sampson2(e, &self.planes[i], noise2) / (self.limit * self.limit);
        let improve = |e: &Matrix3<f64>, inliers: &[usize]| {
            let agreed = Self::selected(self.planes, inliers);
            (inliers.len() > 5)
                .then(|| {
                    polish_epipolar(
                        e,
                        agreed,
                        noise2,
                        self.limit / 2.0,
                        Family::Essential,
                        QUICK_STEPS,
                    )
                })
                .flatten()
        };
        lo_ransac(self.planes.len(), &self.few(), dice, solve, error2, improve)
    }

    fn fundamental(
        &self,
        homography: Option<&Consensus<TwoWay>>,
        dice: &mut Dice,
    ) -> Option<Consensus<Matrix3<f64>>> {
        let solve = |sample: &[usize; 7]| {
            let side = |side: usize| sample.map(|i| self.pairs[i][side]);
            seven_point(&side(0), &side(1))
        };
        let error2 = |f: &Matrix3<f64>, i: usize| self.epipolar_error(f, i);
        let improve = |f: &Matrix3<f64>, inliers: &[usize]| self.reweighed(f, inliers);
        let sampled = lo_ransac(self.pairs.len(), &self.trials, dice, solve, error2, improve);
        self.with_candidate(
            sampled,
            homography.and_then(|found| self.through_plane(found, dice)),
        )
    }

    /// The better of a consensus and one more fundamental matrix, the latter improved.
    fn with_candidate(
        &self,
        best: Option<Consensus<Matrix3<f64>>>,
        candidate: Option<Matrix3<f64>>,
    ) -> Option<Consensus<Matrix3<f64>>> {
        let error2 = |f: &Matrix3<f64>, i: usize| self.epipolar_error(f, i);
        let improve = |f: &Matrix3<f64>, inliers: &[usize]| self.reweighed(f, inliers);
        let count = self.pairs.len();
        let found = candidate.and_then(|candidate| better(candidate, count, best.as_ref(), &error2));
        found
            .map(|found| improved(found, count, &error2, &improve))
            .or(best)
    }

    fn last_polish(&self, found: Consensus<Matrix3<f64>>) -> Consensus<Matrix3<f64>> {
        if found.inliers.len() <= 7 {
            return found;
        }
        let (agreed, scale) = (Self::selected(&self.pairs, &found.inliers), self.limit / 2.0);
        let last = polish_epipolar(
            &found.model,
            agreed,
            [1.0; 2],
            scale,
            Family::Fundamental,
            LAST_STEPS,
        );
        let error2 = |f: &Matrix3<f64>, i: usize| self.epipolar_error(f, i);
        last.and_then(|model| better(model, self.pairs.len(), Some(&found), &error2))
            .unwrap_or(found)
    }

    fn epipolar_error(&self, fundamental: &Matrix3<f64>, i: usize) -> f64 {
        sampson2(fundamental, &self.pairs[i], [1.0; 2]) / (self.limit * self.limit)
    }

    /// Eight-point least squares, each pair weighed by the slope of its Sampson error at the model so far.
    fn reweighed(&self, fundamental: &Matrix3<f64>, inliers: &[usize]) -> Option<Matrix3<f64>> {
        let agreed: Vec<Pair> = Self::selected(&self.pairs, inliers).copied().collect();
        let weight = |[p, q]: &Pair| {
            let lines = [fundamental * p.push(1.0), fundamental.tr_mul(&q.push(1.0))];
            let spread = lines[0].xy().norm_squared() + lines[1].xy().norm_squared();
            // At an epipole the slope is 0: a floor keeps one pair from weighing all.
            1.0 / (spread + 1e-6)
        };
        let weights: Vec<f64> = agreed.iter().map(weight).collect();
        eight_point(&agreed, &weights)
    }

    /// The fundamental matrix that holds the plane and most matches off it: two of those meet in the
    /// epipole.
    fn through_plane(&self, plane: &Consensus<TwoWay>, dice: &mut Dice) -> Option<Matrix3<f64>> {
        let h = &plane.model[0];
        let off: Vec<usize> = (0..self.pairs.len())
            .filter(|i| plane.inliers.binary_search(i).is_err())
            .collect();
        // The line on which the epipole lies: from where the plane would put a point to where it is.
        let line = |i: usize| {
            let [p, q] = &self.pairs[off[i]];
            q.push(1.0).cross(&(h * p.push(1.0)))
        };
        let solve = |sample: &[usize; 2]| {
            let epipole = line(sample[0]).cross(&line(sample[1])).try_normalize(1e-14);
            epipole
                .map(|epipole| cross_matrix(&epipole) * h)
                .into_iter()
                .collect()
        };
        let error2 = |f: &Matrix3<f64>, i: usize| self.epipolar_error(f, off[i]);
        let trials = Trials {
            most: PARALLAX_TRIALS,
            least: 2,
            ..self.trials
        };
        let found = lo_ransac(off.len(), &trials, dice, solve, error2, |_, _| None);
        // With nothing off the plane any epipole does.
        Some(found.map_or_else(|| cross_matrix(&Vector3::x()) * h, |found| found.model))
    }
}

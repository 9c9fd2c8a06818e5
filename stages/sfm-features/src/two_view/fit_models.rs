//! Robust estimation of fundamental matrix, essential matrix and homography from the matches of a pair.

use marf_numeric::Rng;
use nalgebra::{Matrix3, Vector3};

use super::correspondences::{Correspondences, centring, focal_px, intrinsics};
use super::types::{FocalKnown, VerifyOptions};
use crate::estimators::{
    Consensus, EpipolarModel, InvertibleHomography, PointPair, RansacOptions, cross_matrix, eight_point,
    five_point, locally_optimised, ransac_homography, sampson2, scored_if_better, seven_point,
};

/// Largest number of samples of seven points. For five and four points it is a quarter.
const MAX_SAMPLES: u32 = 2000;
/// Wanted probability of one sample without outliers.
const CONFIDENCE: f64 = 0.999;

/// Damped steps of a refinement inside the search, and of the last one.
const QUICK_STEPS: usize = 3;
const LAST_STEPS: usize = 10;

/// Samples of two points off the plane: with 0.2 of true matches all miss with probability 3e-4.
const PARALLAX_SAMPLES: u32 = 200;

/// The three models with their consensus over the same matches.
pub(super) struct TwoViewModels {
    /// In undistorted pixels.
    pub fundamental: Option<Consensus<Matrix3<f64>>>,
    pub essential: Option<Consensus<Matrix3<f64>>>,
    pub homography: Option<Consensus<InvertibleHomography>>,
}

impl TwoViewModels {
    /// Returns the numbers of inliers: fundamental matrix, essential matrix, homography.
    pub(super) fn counts(&self) -> [usize; 3] {
        let count = |found: &Option<Consensus<Matrix3<f64>>>| found.as_ref().map_or(0, |c| c.inliers.len());
        let homography = self.homography.as_ref().map_or(0, |c| c.inliers.len());
        [count(&self.fundamental), count(&self.essential), homography]
    }
}

/// What the three estimations share.
struct Search<'a> {
    /// Undistorted pixels, centred and scaled.
    pairs: Vec<PointPair>,
    /// Undistorted, at z = 1.
    planes: &'a [PointPair],
    /// Largest error, in the unit of `pairs`.
    limit: f64,
    options: RansacOptions,
}

/// Returns the three models (the essential matrix only with known focal lengths).
///
/// The seven-point algorithm is degenerate on a plane. So the homography and the essential matrix propose fundamental
/// matrices too (plane and parallax: F = [e]x H, Chum, Werner, Matas, CVPR 2005). The one of lowest cost is kept.
pub(super) fn fit_models(
    correspondences: &Correspondences<'_>,
    focal: FocalKnown,
    options: &VerifyOptions,
    min_inliers: usize,
    rng: &mut Rng,
) -> TwoViewModels {
    let [a, b] = correspondences.cameras;
    let unit = 0.5 * f64::from(a.width.max(a.height).max(b.width).max(b.height));
    let to_1 = centring(a, unit) * intrinsics(a);
    let to_2 = centring(b, unit) * intrinsics(b);
    let carried = |to: &Matrix3<f64>, plane: &nalgebra::Vector2<f64>| (to * plane.push(1.0)).xy();
    let pairs = correspondences
        .planes
        .iter()
        .map(|[p, q]| [carried(&to_1, p), carried(&to_2, q)])
        .collect();
    let ransac = RansacOptions {
        max_samples: MAX_SAMPLES,
        confidence: CONFIDENCE,
        min_inliers,
    };
    let search = Search {
        pairs,
        planes: &correspondences.planes,
        limit: options.max_error_px / unit,
        options: ransac,
    };
    let homography = search.homography(rng);
    let fundamental = search.fundamental(homography.as_ref(), rng);
    let agreed = |count: Option<usize>| count.is_some_and(|count| count >= min_inliers);
    // Where both fail, five points fail too: their samples reach the same share of inliers.
    let hopeful = agreed(fundamental.as_ref().map(|found| found.inliers.len()))
        || agreed(homography.as_ref().map(|found| found.inliers.len()));
    let noise2 = [a, b].map(|camera| unit * unit / (focal_px(camera) * focal_px(camera)));
    let essential = (focal == FocalKnown::Known && hopeful)
        .then(|| search.essential(noise2, rng))
        .flatten();
    let proposed = essential
        .as_ref()
        .and_then(|essential| Some(to_2.try_inverse()?.transpose() * essential.model * to_1.try_inverse()?));
    let fundamental = search
        .with_candidate(fundamental, proposed)
        .map(|found| search.refined(found));
    let (to_1, to_2) = (centring(a, unit), centring(b, unit));
    let fundamental = fundamental.map(|found| Consensus {
        model: (to_2.transpose() * found.model * to_1).normalize(),
        ..found
    });
    TwoViewModels {
        fundamental,
        essential,
        homography,
    }
}

impl Search<'_> {
    /// Returns the inliers of a list.
    fn selected<'a>(
        from: &'a [PointPair],
        inliers: &'a [usize],
    ) -> impl Iterator<Item = &'a PointPair> + Clone {
        inliers.iter().map(|&i| &from[i])
    }

    /// Returns the options for smaller samples.
    fn few(&self) -> RansacOptions {
        // Five points in 500 trials reach the share of inliers that seven reach in 2000: 0.44. Four reach 0.34.
        RansacOptions {
            max_samples: self.options.max_samples.div_ceil(4),
            ..self.options
        }
    }

    /// Returns the homography with the largest consensus.
    fn homography(&self, rng: &mut Rng) -> Option<Consensus<InvertibleHomography>> {
        ransac_homography(&self.pairs, [1.0; 2], self.limit, &self.few(), rng)
    }

    /// `noise2`: one unit of `pairs` in plane units, squared. Errors are in that unit.
    fn essential(&self, noise2: [f64; 2], rng: &mut Rng) -> Option<Consensus<Matrix3<f64>>> {
        let solve = |sample: &[usize; 5]| {
            let side = |side: usize| sample.map(|i| self.planes[i][side]);
            five_point(&side(0), &side(1))
        };
        let error2 =
            |e: &Matrix3<f64>, i: usize| sampson2(e, &self.planes[i], noise2) / (self.limit * self.limit);
        let improve = |e: &Matrix3<f64>, inliers: &[usize]| {
            let agreed = Self::selected(self.planes, inliers);
            (inliers.len() > 5)
                .then(|| EpipolarModel::Essential.refined(e, agreed, noise2, self.limit / 2.0, QUICK_STEPS))
                .flatten()
        };
        self.few()
            .lo_ransac(self.planes.len(), rng, solve, error2, improve)
    }

    /// Returns the best fundamental matrix, by seven points or through the homography.
    fn fundamental(
        &self,
        homography: Option<&Consensus<InvertibleHomography>>,
        rng: &mut Rng,
    ) -> Option<Consensus<Matrix3<f64>>> {
        let solve = |sample: &[usize; 7]| {
            let side = |side: usize| sample.map(|i| self.pairs[i][side]);
            seven_point(&side(0), &side(1))
        };
        let error2 = |f: &Matrix3<f64>, i: usize| self.epipolar_error(f, i);
        let improve = |f: &Matrix3<f64>, inliers: &[usize]| self.reweighted(f, inliers);
        let sampled = self
            .options
            .lo_ransac(self.pairs.len(), rng, solve, error2, improve);
        self.with_candidate(
            sampled,
            homography.and_then(|found| self.through_plane(found, rng)),
        )
    }

    /// Returns the better of a consensus and one more fundamental matrix, the latter locally optimised.
    fn with_candidate(
        &self,
        best: Option<Consensus<Matrix3<f64>>>,
        candidate: Option<Matrix3<f64>>,
    ) -> Option<Consensus<Matrix3<f64>>> {
        let error2 = |f: &Matrix3<f64>, i: usize| self.epipolar_error(f, i);
        let improve = |f: &Matrix3<f64>, inliers: &[usize]| self.reweighted(f, inliers);
        let count = self.pairs.len();
        let found =
            candidate.and_then(|candidate| scored_if_better(candidate, count, best.as_ref(), &error2));
        found
            .map(|found| locally_optimised(found, count, &error2, &improve))
            .or(best)
    }

    /// Returns a fundamental matrix refined on its inliers, if that lowers its cost.
    fn refined(&self, found: Consensus<Matrix3<f64>>) -> Consensus<Matrix3<f64>> {
        if found.inliers.len() <= 7 {
            return found;
        }
        let (agreed, scale) = (Self::selected(&self.pairs, &found.inliers), self.limit / 2.0);
        let last = EpipolarModel::Fundamental.refined(&found.model, agreed, [1.0; 2], scale, LAST_STEPS);
        let error2 = |f: &Matrix3<f64>, i: usize| self.epipolar_error(f, i);
        last.and_then(|model| scored_if_better(model, self.pairs.len(), Some(&found), &error2))
            .unwrap_or(found)
    }

    /// Returns the squared Sampson error over the squared limit.
    fn epipolar_error(&self, fundamental: &Matrix3<f64>, i: usize) -> f64 {
        sampson2(fundamental, &self.pairs[i], [1.0; 2]) / (self.limit * self.limit)
    }

    /// Returns the eight-point solution, each match weighted by the gradient of its Sampson error at the given model.
    fn reweighted(&self, fundamental: &Matrix3<f64>, inliers: &[usize]) -> Option<Matrix3<f64>> {
        let agreed: Vec<PointPair> = Self::selected(&self.pairs, inliers).copied().collect();
        let weight = |[p, q]: &PointPair| {
            let lines = [fundamental * p.push(1.0), fundamental.tr_mul(&q.push(1.0))];
            let spread = lines[0].xy().norm_squared() + lines[1].xy().norm_squared();
            // At an epipole the gradient is 0: the constant bounds the weight.
            1.0 / (spread + 1e-6)
        };
        let weights: Vec<f64> = agreed.iter().map(weight).collect();
        eight_point(&agreed, &weights)
    }

    /// Returns the fundamental matrix through a homography that has most inliers off the plane: the epipolar lines of two of
    /// those intersect in the epipole.
    fn through_plane(&self, plane: &Consensus<InvertibleHomography>, rng: &mut Rng) -> Option<Matrix3<f64>> {
        let h = &plane.model[0];
        let off: Vec<usize> = (0..self.pairs.len())
            .filter(|i| plane.inliers.binary_search(i).is_err())
            .collect();
        // The line on which the epipole lies: from where the homography maps a point to where it is.
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
        let options = RansacOptions {
            max_samples: PARALLAX_SAMPLES,
            min_inliers: 2,
            ..self.options
        };
        let found = options.lo_ransac(off.len(), rng, solve, error2, |_, _| None);
        // Without matches off the plane any epipole will do.
        Some(found.map_or_else(|| cross_matrix(&Vector3::x()) * h, |found| found.model))
    }
}

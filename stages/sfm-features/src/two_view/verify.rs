//! Geometric verification of matches.

use marf_numeric::Rng;

use super::correspondences::{Correspondences, intrinsics};
use super::fit_models::{TwoViewModels, fit_models};
use super::types::{FocalKnown, VerifiedKind, VerifiedPair, VerifyOptions, ViewPoints};
use crate::estimators::sampson2;

/// A pair is planar if a homography explains more than this share of its inliers.
pub(super) const PLANAR_SHARE: f64 = 0.8;

/// Share of inliers that do not move from which a pair is stationary, and share of fitting ones from which matches that do
/// not move are used.
const STATIONARY_SHARE: f64 = 0.8;

/// Share of the fundamental matrix's inliers from which those of the essential matrix are taken instead (COLMAP).
const ESSENTIAL_SHARE: f64 = 0.95;

/// Returns the matches that agree with a two-view geometry, and its kind.
///
/// Fundamental matrix and homography are always estimated, the essential matrix if both focal lengths are known.
/// Matches that move by at most `max_error_px` (hardware, lens dirt, watermark) are first left out if others move. If
/// those verify alone, the stationary ones are used only if at least 0.8 of them fit. For a plane both the inliers on
/// it and those off it are kept. Points without a ray are dropped. For random matches see `min_inliers`.
pub fn verify(
    views: [&ViewPoints<'_>; 2],
    matches: &[[u32; 2]],
    focal: FocalKnown,
    options: &VerifyOptions,
    seed: u64,
) -> VerifiedPair {
    let correspondences = Correspondences::new(views, matches);
    let mut rng = Rng::new(seed);
    let mut estimate = |correspondences: &Correspondences<'_>| {
        let needed = min_inliers(correspondences, options);
        let models = fit_models(correspondences, focal, options, needed, &mut rng);
        conclude(correspondences, &models, needed)
    };
    let [size_a, size_b] = correspondences
        .cameras
        .map(|camera| (camera.width, camera.height));
    let is_stationary = |i: &usize| {
        let [p, q] = &correspondences.pixels[*i];
        size_a == size_b && (p - q).norm() <= options.max_error_px
    };
    let (stationary, moving) = (0..correspondences.len()).partition::<Vec<usize>, _>(is_stationary);
    if !stationary.is_empty() && moving.len() >= options.min_inliers as usize {
        let verdict = estimate(&correspondences.subset(&moving));
        if verdict.kind != VerifiedKind::None
            && !stationary_fit(&correspondences, &stationary, &verdict, options)
        {
            return verdict;
        }
    }
    let mut verdict = estimate(&correspondences);
    let resting: Vec<[u32; 2]> = stationary.iter().map(|&i| correspondences.matches[i]).collect();
    let stationary_inliers = verdict.inliers.iter().filter(|m| resting.contains(m)).count();
    if verdict.kind != VerifiedKind::None
        && stationary_inliers as f64 >= STATIONARY_SHARE * verdict.inliers.len() as f64
    {
        verdict.kind = VerifiedKind::Stationary;
    }
    verdict
}

/// Whether most stationary matches fit the geometry of the moving ones: then they are distant points, not dirt. Half
/// of the dirt may fit by chance if all points move alike, all of it if the camera does not rotate.
fn stationary_fit(
    correspondences: &Correspondences<'_>,
    stationary: &[usize],
    verdict: &VerifiedPair,
    options: &VerifyOptions,
) -> bool {
    let Some(fundamental) = verdict.fundamental else {
        return false;
    };
    let limit2 = options.max_error_px * options.max_error_px;
    let [k_1, k_2] = correspondences.cameras.map(intrinsics);
    let fits = |i: &&usize| {
        let [p, q] = &correspondences.planes[**i];
        let pair = [(k_1 * p.push(1.0)).xy(), (k_2 * q.push(1.0)).xy()];
        sampson2(&fundamental, &pair, [1.0; 2]) <= limit2
    };
    stationary.iter().filter(fits).count() as f64 >= STATIONARY_SHARE * stationary.len() as f64
}

/// Returns the smallest number of inliers that is not expected by chance. Of n random matches a fundamental matrix
/// holds seven and about n p more. Here p = 2 sqrt(2) error x diagonal / area is the share of the photo near an
/// epipolar line. 7 sigmas are added for the thousands of matrices tried.
fn min_inliers(correspondences: &Correspondences<'_>, options: &VerifyOptions) -> usize {
    let camera = correspondences.cameras[1];
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let diagonal = (width * width + height * height).sqrt();
    let near = 2.0 * std::f64::consts::SQRT_2 * options.max_error_px * diagonal / (width * height);
    let by_chance = correspondences.len() as f64 * near.min(1.0);
    let bound = (7.0 + by_chance + 7.0 * by_chance.sqrt()).ceil() as usize;
    bound.max(options.min_inliers as usize)
}

/// Returns kind and inliers of the fitted models.
fn conclude(correspondences: &Correspondences<'_>, models: &TwoViewModels, needed: usize) -> VerifiedPair {
    let [fundamental, essential, homography] = models.counts();
    let most = fundamental.max(essential);
    let kind = match most.max(homography) {
        count if count < needed => VerifiedKind::None,
        _ if homography as f64 > PLANAR_SHARE * most as f64 => VerifiedKind::Planar,
        _ => VerifiedKind::General,
    };
    let calibrated = essential as f64 >= ESSENTIAL_SHARE * fundamental as f64;
    let chosen = if calibrated {
        models.essential.as_ref()
    } else {
        models.fundamental.as_ref()
    };
    let mut inliers: Vec<usize> = chosen.map_or_else(Vec::new, |found| found.inliers.clone());
    if let Some(plane) = models
        .homography
        .as_ref()
        .filter(|_| kind == VerifiedKind::Planar)
    {
        inliers.extend(&plane.inliers);
        inliers.sort_unstable();
        inliers.dedup();
    }
    let keep = kind != VerifiedKind::None;
    VerifiedPair {
        inliers: inliers
            .iter()
            .filter(|_| keep)
            .map(|&i| correspondences.matches[i])
            .collect(),
        fundamental: models
            .fundamental
            .as_ref()
            .filter(|_| keep)
            .map(|found| found.model),
        kind,
    }
}

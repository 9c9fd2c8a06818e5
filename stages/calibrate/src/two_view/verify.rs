//! Raw matches in, a verdict out.

use super::judge::{Judged, judge};
use super::spots::Spots;
use super::{FocalKnown, Verified, VerifiedKind, VerifyOptions, ViewPoints};
use crate::dice::Dice;
use crate::estimators::sampson2;

/// A homography that explains this share of a pair's inliers leaves it planar.
pub(super) const PLANAR_SHARE: f64 = 0.8;

/// This share of inliers at rest makes a pair stationary; this share of fitting ones brings those at rest
/// back.
const STILL_SHARE: f64 = 0.8;

/// An essential matrix that keeps this share of the fundamental matrix's inliers speaks for the pair
/// (COLMAP's value).
const ESSENTIAL_SHARE: f64 = 0.95;

/// Judges raw matches.
///
/// Fundamental matrix and homography always, essential matrix when both focal lengths are known. Matches
/// that stay within `max_error_px` of their place (hardware, lens dirt, watermark) are first left out where
/// the others move: if those verify alone, the still ones come back only if at least .8 of them fit. Of a
/// plane both the inliers on it and those off it are kept. Points without a ray are dropped. Random
/// matches: see `least_inliers`.
pub(crate) fn verify(
    a: &ViewPoints,
    b: &ViewPoints,
    matches: &[[u32; 2]],
    focal: FocalKnown,
    options: &VerifyOptions,
    seed: u64,
) -> Verified {
    let spots = Spots::new(a, b, matches);
    let mut dice = Dice::new(seed);
    let mut try_on = |spots: &Spots| {
        let least = least_inliers(spots.len(), b, options);
        let cameras = [a.camera, b.camera];
        conclude(
            spots,
            &judge(cameras, spots, focal, options, least, &mut dice),
            least,
        )
    };
    let same_size = (a.camera.width, a.camera.height) == (b.camera.width, b.camera.height);
    let rests = |i: &usize| {
        let [p, q] = &spots.pixels[*i];
        same_size && (p - q).norm() <= options.max_error_px
    };
    let (still, moving): (Vec<usize>, Vec<usize>) = (0..spots.len()).partition(rests);
    if !still.is_empty() && moving.len() >= options.min_inliers as usize {
        let verdict = try_on(&spots.subset(&moving));
        if verdict.kind != VerifiedKind::None && !still_ones_fit(a, b, &spots, &still, &verdict, options) {
            return verdict;
        }
    }
    let mut verdict = try_on(&spots);
    let resting: Vec<[u32; 2]> = still.iter().map(|&i| spots.matches[i]).collect();
    let at_rest = verdict.inliers.iter().filter(|m| resting.contains(m)).count();
    if verdict.kind != VerifiedKind::None && at_rest as f64 >= STILL_SHARE * verdict.inliers.len() as f64 {
        verdict.kind = VerifiedKind::Stationary;
    }
    verdict
}

/// Tells whether most matches at rest fit what the moving ones found: then they are far away, not dirt.
/// Half of the dirt may fit by chance where all points move alike, all of it where the camera does not
/// turn.
fn still_ones_fit(
    a: &ViewPoints,
    b: &ViewPoints,
    spots: &Spots,
    still: &[usize],
    verdict: &Verified,
    options: &VerifyOptions,
) -> bool {
    let Some(fundamental) = verdict.fundamental else {
        return false;
    };
    let limit2 = options.max_error_px * options.max_error_px;
    let (k_1, k_2) = (
        super::spots::intrinsics(a.camera),
        super::spots::intrinsics(b.camera),
    );
    let fits = |i: &&usize| {
        let [p, q] = &spots.planes[**i];
        let pair = [(k_1 * p.push(1.0)).xy(), (k_2 * q.push(1.0)).xy()];
        sampson2(&fundamental, &pair, [1.0; 2]) <= limit2
    };
    still.iter().filter(fits).count() as f64 >= STILL_SHARE * still.len() as f64
}

/// Fewest inliers that chance does not give: of n random matches a fundamental matrix holds seven and about
/// n p more, where p = 2 sqrt(2) error x diagonal / area is the share of the photo near an epipolar line; 7
/// sigmas are added for the thousands of matrices tried.
fn least_inliers(count: usize, b: &ViewPoints, options: &VerifyOptions) -> usize {
    let (width, height) = (f64::from(b.camera.width), f64::from(b.camera.height));
    let diagonal = (width * width + height * height).sqrt();
    let near = 2.0 * std::f64::consts::SQRT_2 * options.max_error_px * diagonal / (width * height);
    let by_chance = count as f64 * near.min(1.0);
    let bound = (7.0 + by_chance + 7.0 * by_chance.sqrt()).ceil() as usize;
    bound.max(options.min_inliers as usize)
}

fn conclude(spots: &Spots, judged: &Judged, least: usize) -> Verified {
    let [fundamental, essential, homography] = judged.counts();
    let most = fundamental.max(essential);
    let kind = match most.max(homography) {
        count if count < least => VerifiedKind::None,
        _ if homography as f64 > PLANAR_SHARE * most as f64 => VerifiedKind::Planar,
        _ => VerifiedKind::General,
    };
    let calibrated = essential as f64 >= ESSENTIAL_SHARE * fundamental as f64;
    let chosen = if calibrated {
        judged.essential.as_ref()
    } else {
        judged.fundamental.as_ref()
    };
    let mut inliers: Vec<usize> = chosen.map_or_else(Vec::new, |found| found.inliers.clone());
    if let Some(plane) = judged
        .homography
        .as_ref()
        .filter(|_| kind == VerifiedKind::Planar)
    {
        inliers.extend(&plane.inliers);
        inliers.sort_unstable();
        inliers.dedup();
    }
    let keep = kind != VerifiedKind::None;
    Verified {
        inliers: inliers
            .iter()
            .filter(|_| keep)
            .map(|&i| spots.matches[i])
            .collect(),
        fundamental: judged
            .fundamental
            .as_ref()
            .filter(|_| keep)
            .map(|found| found.model),
        fundamental_inliers: fundamental as u32,
        essential_inliers: essential as u32,
        homography_inliers: homography as u32,
        kind,
    }
}

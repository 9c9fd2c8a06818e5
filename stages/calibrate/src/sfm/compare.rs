//! Which pairs of photos to compare, and their verified matches, computed or from the memo.

use std::collections::BTreeSet;

use marf_cache::{Digest, digest_of};
use marf_schema::calibrate::{CalibrateParams, Pairs};
use marf_sfm::view_graph::{ComparedPair, PosedCamera, SharedCamera, View, focal_known, max_error_px};
use marf_sfm_features::features::Features;
use marf_sfm_features::matching::{Samples, exhaustive, match_pair, most_similar, sequential};
use marf_sfm_features::two_view::{FocalKnown, VerifiedPair, VerifyOptions, ViewPoints, verify};
use marf_stage::{Ctx, StageError};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use super::pair_memos::{PairFunction, map_pairs};
use super::photo_features::PhotoFeatures;

/// Raised when matching or verification may change.
const VERSION: u32 = 1;
/// Sets up to this size are compared exhaustively: 1,770 pairs.
const EXHAUSTIVE_PHOTOS: usize = 60;
/// Next photos in capture order that each photo is compared with.
const OVERLAP: usize = 2;
/// Most similar photos that each photo is compared with, and the smallest number of matches that counts as similar.
const RETRIEVED: usize = 20;
const MIN_RETRIEVAL_MATCHES: usize = 6;
/// Photos that by their labels overlap most with a photo, which each photo is compared with.
const BY_LABEL: usize = 20;
/// Distances at which the overlap by labels is computed, in metres.
const RANGES_M: [f64; 4] = [1.5, 4.0, 10.0, 30.0];

/// Returns the pairs to compare, each once, sorted.
///
/// # Errors
/// A request to stop.
pub(super) fn choose(
    ctx: &Ctx<'_>,
    features: &[PhotoFeatures],
    sequence: &[usize],
    params: &CalibrateParams,
) -> Result<Vec<[usize; 2]>, StageError> {
    let count = features.len();
    let all: Vec<[usize; 2]> = exhaustive(count).into_iter().map(|(a, b)| [a, b]).collect();
    if params.pairs == Pairs::Exhaustive || (params.pairs == Pairs::Auto && count <= EXHAUSTIVE_PHOTOS) {
        return Ok(all);
    }
    let ordered = |a: usize, b: usize| [a.min(b), a.max(b)];
    let mut pairs: BTreeSet<[usize; 2]> = sequential(count, OVERLAP)
        .into_iter()
        .map(|(a, b)| ordered(sequence[a], sequence[b]))
        .collect();
    if params.pairs == Pairs::Auto {
        let found: Vec<&Features> = features.iter().map(|one| &one.features).collect();
        let similarity = Similarity {
            features,
            samples: Samples::new(&found),
        };
        let matches = map_pairs(ctx, &names(features), &all, &similarity)?;
        let matches: Vec<([usize; 2], usize)> = all.into_iter().zip(matches).collect();
        let similar = most_similar(count, &matches, RETRIEVED, MIN_RETRIEVAL_MATCHES);
        pairs.extend(similar.into_iter().map(|(a, b)| ordered(a, b)));
        pairs.extend(by_label(ctx, features)?);
    }
    Ok(pairs.into_iter().collect())
}

/// Returns for each labelled photo the pairs with those that by their labels overlap most with it.
fn by_label(ctx: &Ctx<'_>, features: &[PhotoFeatures]) -> Result<Vec<[usize; 2]>, StageError> {
    let labels = features.iter().enumerate().filter_map(|(index, one)| {
        let (camera, cam_from_world) = one.row.label?;
        Some((
            index,
            PosedCamera {
                camera,
                cam_from_world,
            },
        ))
    });
    let labels: Vec<(usize, PosedCamera)> = labels.collect();
    let chosen: Result<Vec<Vec<[usize; 2]>>, StageError> = labels
        .par_iter()
        .map(|(index, label)| {
            ctx.check()?;
            let others = labels.iter().filter(|(other, _)| other != index);
            let mut seen: Vec<(usize, usize)> = others
                .map(|(other, against)| (view_overlap(label, against), *other))
                .filter(|(hits, _)| *hits > 0)
                .collect();
            seen.sort_by_key(|&(hits, other)| (std::cmp::Reverse(hits), other));
            seen.truncate(BY_LABEL);
            let pairs = seen.into_iter();
            Ok(pairs
                .map(|(_, other)| [other.min(*index), other.max(*index)])
                .collect())
        })
        .collect();
    Ok(chosen?.concat())
}

/// Returns how many of a grid of points in the view of the first photo are in the view of the second.
pub(crate) fn view_overlap(first: &PosedCamera, second: &PosedCamera) -> usize {
    let (camera, other) = (&first.camera, &second.camera);
    let other_from_cam = second.cam_from_world * first.cam_from_world.inverse();
    let shares = [0.1, 0.3, 0.5, 0.7, 0.9];
    let rays = shares.iter().flat_map(|y| {
        shares.iter().filter_map(move |x| {
            camera.unproject(&Vector2::new(
                x * f64::from(camera.width),
                y * f64::from(camera.height),
            ))
        })
    });
    let sees = |point: Vector3<f64>| other.project_inside(&other_from_cam.point(&point)).is_some();
    rays.map(|ray| {
        RANGES_M
            .iter()
            .filter(|range| sees(ray.normalize() * **range))
            .count()
    })
    .sum()
}

/// Similarity of photos: the number of matches of their samples.
struct Similarity<'a> {
    features: &'a [PhotoFeatures],
    samples: Samples,
}

impl PairFunction for Similarity<'_> {
    type Output = usize;
    const NOTE: &'static str = "photos compared roughly";

    fn table(&self) -> Digest {
        digest_of(&("calibrate similar photos", VERSION))
    }

    fn key(&self, photos: [usize; 2]) -> Digest {
        let mut found = photos.map(|photo| self.features[photo].row.found);
        found.sort_unstable();
        digest_of(&found)
    }

    fn compute(&self, [a, b]: [usize; 2], _key: &Digest) -> Self::Output {
        self.samples.matches(a, b)
    }
}

/// Matching and verification of pairs.
pub(super) struct Comparison<'a> {
    pub features: &'a [PhotoFeatures],
    pub views: &'a [View],
    pub cameras: &'a [SharedCamera],
    pub params: &'a CalibrateParams,
}

impl Comparison<'_> {
    /// Returns the verified matches of the pairs. Results of an earlier run are taken from the memos.
    pub(super) fn run(&self, ctx: &Ctx<'_>, pairs: &[[usize; 2]]) -> Result<Vec<ComparedPair>, StageError> {
        let verified = map_pairs(ctx, &names(self.features), pairs, self)?;
        let compared = pairs.iter().zip(verified);
        Ok(compared
            .map(|(&photos, verified)| ComparedPair { photos, verified })
            .collect())
    }
}

/// Returns the identity of each photo in the tables of pairs.
pub(super) fn names(features: &[PhotoFeatures]) -> Vec<Digest> {
    features.iter().map(|one| one.row.found).collect()
}

/// Returns the digest of features and cameras of a pair.
pub(super) fn photos_key(
    photos: [usize; 2],
    features: &[PhotoFeatures],
    views: &[View],
    cameras: &[SharedCamera],
) -> Digest {
    let camera = |photo: usize| {
        let shared = &cameras[views[photo].camera];
        (shared.camera, shared.focal == FocalKnown::Known)
    };
    let parts = (photos.map(|photo| features[photo].row.found), photos.map(camera));
    Digest::from_content(&serde_json::to_vec(&parts).unwrap_or_default())
}

impl PairFunction for Comparison<'_> {
    type Output = VerifiedPair;
    const NOTE: &'static str = "pairs compared";

    fn table(&self) -> Digest {
        let (min_matches, seed) = (self.params.min_matches, self.params.seed);
        digest_of(&("calibrate pairs", VERSION, (min_matches, seed)))
    }

    fn key(&self, photos: [usize; 2]) -> Digest {
        // The seed of the random samples is taken from this digest, in the form that results were first computed with.
        let [a, b] = photos;
        let camera = |photo: usize| {
            let shared = &self.cameras[self.views[photo].camera];
            (shared.camera, shared.focal == FocalKnown::Known)
        };
        let found = |photo: usize| self.features[photo].row.found;
        let parts = (found(a), found(b), camera(a), camera(b), self.params.seed);
        Digest::from_content(&serde_json::to_vec(&parts).unwrap_or_default())
    }

    fn compute(&self, photos: [usize; 2], key: &Digest) -> VerifiedPair {
        let [a, b] = photos;
        let (views, cameras) = (self.views, self.cameras);
        let matches = match_pair(&self.features[a].features, &self.features[b].features);
        let points = |photo: usize| ViewPoints {
            camera: &cameras[views[photo].camera].camera,
            pixels: &views[photo].pixels,
        };
        let focal = focal_known(views, cameras, photos);
        let options = VerifyOptions {
            max_error_px: max_error_px(&cameras[views[a].camera].camera),
            min_inliers: self.params.min_matches,
        };
        verify([&points(a), &points(b)], &matches, focal, &options, seed_of(key))
    }
}

/// Returns the first eight bytes of a digest as a seed.
pub(crate) fn seed_of(digest: &Digest) -> u64 {
    digest
        .as_bytes()
        .iter()
        .take(8)
        .fold(0, |seed, byte| seed << 8 | u64::from(*byte))
}

/// Returns inliers as bytes. The seed of relative poses is taken from them, in the form that results were first computed with.
pub(super) fn pack_inliers(inliers: &[[u32; 2]]) -> Vec<u8> {
    let indices = inliers.iter().flatten();
    indices.flat_map(|index| index.to_le_bytes()).collect()
}

//! Which pairs of photos to compare, and their verified matches, computed or from the memo.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU64, Ordering};

use marf_cache::{ContentHash, Digest, digest_of};
use marf_scene::{Camera, Pose};
use marf_schema::calibrate::{CalibrateParams, Pairs};
use marf_sfm::features::Features;
use marf_sfm::matching::{MatchOptions, exhaustive, match_pair, retrieve, sequential};
use marf_sfm::two_view::{FocalKnown, VerifiedKind, VerifiedPair, VerifyOptions, ViewPoints, verify};
use marf_sfm::view_graph::{ComparedPair, SharedCamera, View, focal_known, max_error_px};
use marf_stage::{Ctx, StageError};
use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;

use super::memo_table::MemoTable;
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
pub(super) fn choose(
    features: &[PhotoFeatures],
    sequence: &[usize],
    params: &CalibrateParams,
) -> Vec<[usize; 2]> {
    let count = features.len();
    if params.pairs == Pairs::Exhaustive || (params.pairs == Pairs::Auto && count <= EXHAUSTIVE_PHOTOS) {
        return exhaustive(count).into_iter().map(|(a, b)| [a, b]).collect();
    }
    let ordered = |a: usize, b: usize| [a.min(b), a.max(b)];
    let mut pairs: BTreeSet<[usize; 2]> = sequential(count, OVERLAP)
        .into_iter()
        .map(|(a, b)| ordered(sequence[a], sequence[b]))
        .collect();
    if params.pairs == Pairs::Auto {
        let all: Vec<&Features> = features.iter().map(|one| &one.features).collect();
        pairs.extend(
            retrieve(&all, RETRIEVED, MIN_RETRIEVAL_MATCHES)
                .into_iter()
                .map(|(a, b)| ordered(a, b)),
        );
        pairs.extend(by_label(features));
    }
    pairs.into_iter().collect()
}

/// Returns for each labelled photo the pairs with those that by their labels overlap most with it.
fn by_label(features: &[PhotoFeatures]) -> Vec<[usize; 2]> {
    let labels: Vec<(usize, &(Camera, Pose))> = features
        .iter()
        .enumerate()
        .filter_map(|(index, one)| Some((index, one.row.label.as_ref()?)))
        .collect();
    let chosen: Vec<Vec<[usize; 2]>> = labels
        .par_iter()
        .map(|&(index, label)| {
            let others = labels.iter().filter(|(other, _)| *other != index);
            let mut seen: Vec<(usize, usize)> = others
                .map(|&(other, against)| (overlap(label, against), other))
                .filter(|(hits, _)| *hits > 0)
                .collect();
            seen.sort_by_key(|&(hits, other)| (std::cmp::Reverse(hits), other));
            seen.truncate(BY_LABEL);
            seen.into_iter()
                .map(|(_, other)| [index.min(other), index.max(other)])
                .collect()
        })
        .collect();
    chosen.concat()
}

/// Returns how many of a grid of points in the view of the first photo lie in the second.
fn overlap((camera, cam_from_site): &(Camera, Pose), (other, other_from_site): &(Camera, Pose)) -> usize {
    let other_from_cam = *other_from_site * cam_from_site.inverse();
    let shares = [0.1, 0.3, 0.5, 0.7, 0.9];
    let rays = shares.iter().flat_map(|y| {
        shares.iter().filter_map(move |x| {
            camera.unproject(&Vector2::new(
                x * f64::from(camera.width),
                y * f64::from(camera.height),
            ))
        })
    });
    let inside = |pixel: Vector2<f64>| {
        (0.0..f64::from(other.width)).contains(&pixel.x) && (0.0..f64::from(other.height)).contains(&pixel.y)
    };
    let sees = |point: Vector3<f64>| other.project(&other_from_cam.point(&point)).is_some_and(inside);
    rays.map(|ray| {
        RANGES_M
            .iter()
            .filter(|range| sees(ray.normalize() * **range))
            .count()
    })
    .sum()
}

/// Key of the memo of pairs; its name and fields are part of the key.
#[derive(ContentHash)]
struct MemoKey {
    what: &'static str,
    version: u32,
    min_matches: u32,
    seed: u64,
}

/// Returns the verified matches of the pairs; results of an earlier run are taken from the memo.
pub(super) fn compare(
    ctx: &Ctx<'_>,
    features: &[PhotoFeatures],
    views: &[View],
    cameras: &[SharedCamera],
    pairs: &[[usize; 2]],
    params: &CalibrateParams,
) -> Result<Vec<ComparedPair>, StageError> {
    let key = digest_of(&MemoKey {
        what: "calibrate pairs",
        version: VERSION,
        min_matches: params.min_matches,
        seed: params.seed,
    });
    let mut table = MemoTable::load(ctx, &key);
    let done = AtomicU64::new(0);
    let compared: Vec<Option<(Digest, ComparedPair)>> = pairs
        .par_iter()
        .map(|&photos| {
            if ctx.cancel.is_set() {
                return None;
            }
            let name = row_key(photos, features, views, cameras, params.seed);
            let kept = table.get(&name).and_then(|row| unpack(photos, row));
            let one = kept.unwrap_or_else(|| compared(photos, &name, features, views, cameras, params));
            let so_far = done.fetch_add(1, Ordering::Relaxed) + 1;
            ctx.progress.at(so_far, pairs.len() as u64, "pairs compared");
            Some((name, one))
        })
        .collect();
    for (name, one) in compared.iter().flatten() {
        table.insert(name, pack(one));
    }
    table.save(ctx, &key);
    ctx.check()?;
    Ok(compared.into_iter().flatten().map(|(_, one)| one).collect())
}

/// Returns the digest of all that a row depends on beside the memo's key.
fn row_key(
    [a, b]: [usize; 2],
    features: &[PhotoFeatures],
    views: &[View],
    cameras: &[SharedCamera],
    seed: u64,
) -> Digest {
    let camera = |photo: usize| {
        let shared = &cameras[views[photo].camera];
        (shared.camera, shared.focal == FocalKnown::Known)
    };
    let parts = (
        features[a].row.found,
        features[b].row.found,
        camera(a),
        camera(b),
        seed,
    );
    Digest::of(&serde_json::to_vec(&parts).unwrap_or_default())
}

/// Matches and verifies one pair.
fn compared(
    photos: [usize; 2],
    name: &Digest,
    features: &[PhotoFeatures],
    views: &[View],
    cameras: &[SharedCamera],
    params: &CalibrateParams,
) -> ComparedPair {
    let [a, b] = photos;
    let matches = match_pair(
        &features[a].features,
        &features[b].features,
        &MatchOptions::default(),
    );
    let points = |photo: usize| ViewPoints {
        camera: &cameras[views[photo].camera].camera,
        pixels: &views[photo].pixels,
    };
    let focal = focal_known(views, cameras, photos);
    let options = VerifyOptions {
        max_error_px: max_error_px(&cameras[views[a].camera].camera),
        min_inliers: params.min_matches,
        ..VerifyOptions::default()
    };
    let verified = verify(&points(a), &points(b), &matches, focal, &options, seed_of(name));
    ComparedPair {
        photos,
        matches: matches.len() as u32,
        verified,
    }
}

/// Returns the first eight bytes of a digest as a seed.
pub(super) fn seed_of(digest: &Digest) -> u64 {
    digest
        .as_bytes()
        .iter()
        .take(8)
        .fold(0, |seed, byte| seed << 8 | u64::from(*byte))
}

/// Returns a pair as bytes: kind, matches, three counts, F (or NaN), inliers; little-endian.
fn pack(one: &ComparedPair) -> Vec<u8> {
    let verified = &one.verified;
    let mut bytes = vec![verified.kind as u8];
    for count in [
        one.matches,
        verified.fundamental_inliers,
        verified.essential_inliers,
        verified.homography_inliers,
    ] {
        bytes.extend(count.to_le_bytes());
    }
    let fundamental = verified
        .fundamental
        .unwrap_or_else(|| Matrix3::from_element(f64::NAN));
    bytes.extend(fundamental.iter().flat_map(|value| value.to_le_bytes()));
    bytes.extend(
        verified
            .inliers
            .iter()
            .flatten()
            .flat_map(|index| index.to_le_bytes()),
    );
    bytes
}

/// Reads what [`pack`] wrote.
fn unpack(photos: [usize; 2], row: &[u8]) -> Option<ComparedPair> {
    let (&kind, rest) = row.split_first()?;
    let (counts, rest) = rest.split_at_checked(16)?;
    let (fundamental, rest) = rest.split_at_checked(72)?;
    let (words, []) = counts.as_chunks::<4>() else {
        return None;
    };
    let (numbers, []) = fundamental.as_chunks::<8>() else {
        return None;
    };
    let (inliers, []) = rest.as_chunks::<8>() else {
        return None;
    };
    let counts: Vec<u32> = words.iter().map(|word| u32::from_le_bytes(*word)).collect();
    let fundamental = Matrix3::from_iterator(numbers.iter().map(|number| f64::from_le_bytes(*number)));
    let pair = |bytes: &[u8; 8]| {
        let [a0, a1, a2, a3, b0, b1, b2, b3] = *bytes;
        [
            u32::from_le_bytes([a0, a1, a2, a3]),
            u32::from_le_bytes([b0, b1, b2, b3]),
        ]
    };
    let kinds = [
        VerifiedKind::General,
        VerifiedKind::Planar,
        VerifiedKind::Stationary,
        VerifiedKind::None,
    ];
    let kind = kinds.into_iter().find(|one| *one as u8 == kind)?;
    Some(ComparedPair {
        photos,
        matches: counts[0],
        verified: VerifiedPair {
            inliers: inliers.iter().map(pair).collect(),
            fundamental: fundamental
                .iter()
                .all(|value| value.is_finite())
                .then_some(fundamental),
            fundamental_inliers: counts[1],
            essential_inliers: counts[2],
            homography_inliers: counts[3],
            kind,
        },
    })
}

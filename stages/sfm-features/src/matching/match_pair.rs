//! Matches of two photos by their descriptors.

use super::nearest::{ColumnBlocks, NearestTwo, nearest};
use crate::features::Features;
use crate::simd::InstructionSet;

/// Largest ratio of the angle to the nearest descriptor and that to the second nearest, in both directions (COLMAP).
const MAX_RATIO: f32 = 0.8;
/// Largest angle between descriptors that match (COLMAP).
const MAX_ANGLE_RAD: f32 = 0.7;

/// Returns the matches (index in a, index in b) of two photos, sorted by a: mutual nearest neighbours that pass the
/// ratio test and the distance limit.
///
/// The ratio test holds in both directions, hence `match_pair(b, a)` gives the same matches with the indices swapped.
/// Features of one keypoint with two orientations (position and scale equal to the bit) count as one. A keypoint
/// takes part in at most one match, that of the greatest dot product (ties: lower indices). A match names the first
/// feature of its keypoints, so that a track through three photos is not cut where its matches used different
/// orientations. The features of a keypoint must be neighbours in the list, as `extract` leaves them.
pub fn match_pair(a: &Features, b: &Features) -> Vec<[u32; 2]> {
    let found = mutual(
        InstructionSet::best(),
        &a.descriptors,
        &ColumnBlocks::new(&b.descriptors),
    );
    one_per_keypoint(found, &first_of_keypoint(a), &first_of_keypoint(b))
}

/// The dot product of a match, and the match.
type ScoredMatch = (i32, [u32; 2]);

/// Returns the mutual nearest neighbours that pass the ratio test and the distance limit, sorted by a.
pub(super) fn mutual(set: InstructionSet, a: &[[u8; 128]], b: &ColumnBlocks) -> Vec<ScoredMatch> {
    let (rows, columns) = nearest(set, a, b);
    let matches = rows.iter().zip(0_u32..).filter_map(|(row, index)| {
        let column = columns.get(row.index as usize)?;
        let good = column.index == index && passes(row) && passes(column);
        good.then_some((row.best, [index, row.index]))
    });
    matches.collect()
}

/// Whether the nearest descriptor passes the distance limit and the ratio test.
fn passes(near: &NearestTwo) -> bool {
    let angle = |dot: i32| libm::acos((f64::from(dot) / f64::from(512 * 512)).min(1.0));
    let (first, second) = (angle(near.best), angle(near.second));
    first <= f64::from(MAX_ANGLE_RAD) && first < f64::from(MAX_RATIO) * second
}

/// Returns for each feature the first feature of its keypoint: same position and scale.
fn first_of_keypoint(features: &Features) -> Vec<u32> {
    let place = |index: usize| {
        let point = features.keypoints.get(index)?;
        Some([point.x_px, point.y_px, point.scale_px].map(f32::to_bits))
    };
    let mut first = 0;
    let of_keypoint = |index: usize| {
        if place(index) != place(first) {
            first = index;
        }
        first as u32
    };
    (0..features.descriptors.len()).map(of_keypoint).collect()
}

/// Returns the best match of every keypoint on both sides, named by their first features.
fn one_per_keypoint(mut matches: Vec<ScoredMatch>, first_a: &[u32], first_b: &[u32]) -> Vec<[u32; 2]> {
    matches.sort_by_key(|&(dot, pair)| (std::cmp::Reverse(dot), pair));
    let mut taken = (vec![false; first_a.len()], vec![false; first_b.len()]);
    let mut pairs = Vec::with_capacity(matches.len());
    for (_, [a, b]) in matches {
        let (a, b) = (first_a[a as usize], first_b[b as usize]);
        if taken.0[a as usize] || taken.1[b as usize] {
            continue;
        }
        (taken.0[a as usize], taken.1[b as usize]) = (true, true);
        pairs.push([a, b]);
    }
    pairs.sort_unstable();
    pairs
}

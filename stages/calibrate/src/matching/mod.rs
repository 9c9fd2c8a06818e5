//! Which photos to compare, and which of their features are the same point.
//!
//! Pure functions of descriptors in whole numbers: any instruction set, any number of threads, the same pairs.

mod nearest;
mod pairs;

use crate::features::Features;
use crate::simd::Isa;
use nearest::{Near, Packed, nearest};

pub(crate) use pairs::{exhaustive, retrieve, sequential};

/// What makes two features the same point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MatchOptions {
    /// Largest angle to the nearest descriptor over the angle to the second nearest, both ways.
    pub max_ratio: f32,
    /// Largest angle between descriptors, radians.
    pub max_distance: f32,
}

impl Default for MatchOptions {
    /// COLMAP's.
    fn default() -> Self {
        Self {
            max_ratio: 0.8,
            max_distance: 0.7,
        }
    }
}

/// Returns pairs (index in a, index in b) that are each other's nearest, unambiguous and near enough; sorted by a.
///
/// The ratio holds in both directions, hence `match_pair(b, a)` is the same pairs turned round. Features of one
/// spot (one keypoint with two orientations, to the bit at one place and scale) count as one point: a spot takes
/// part in at most one pair, the one of the greatest dot product (ties: lower indices), and a pair names the
/// first feature of its spots, so that a track through three photos is not cut where two of its pairs met
/// different orientations. The spots of a photo must be neighbours in the list, as `extract` leaves them.
pub(crate) fn match_pair(a: &Features, b: &Features, options: &MatchOptions) -> Vec<[u32; 2]> {
    let found = mutual(Isa::best(), &a.descriptors, &Packed::new(&b.descriptors), options);
    one_a_spot(found, &spots(a), &spots(b))
}

/// A pair and its dot product.
type Hit = (i32, [u32; 2]);

/// Returns mutual, unambiguous, near pairs, sorted by a.
fn mutual(isa: Isa, a: &[[u8; 128]], b: &Packed, options: &MatchOptions) -> Vec<Hit> {
    let (rows, columns) = nearest(isa, a, b);
    let hits = rows.iter().zip(0..).filter_map(|(row, index): (&Near, u32)| {
        let column = columns.get(row.index as usize)?;
        let good = column.index == index && is_clear(row, options) && is_clear(column, options);
        good.then_some((row.best, [index, row.index]))
    });
    hits.collect()
}

/// Tells whether the nearest is near and the second nearest is not nearly as near.
fn is_clear(near: &Near, options: &MatchOptions) -> bool {
    let angle = |dot: i32| libm::acos((f64::from(dot) / f64::from(512 * 512)).min(1.0));
    let (first, second) = (angle(near.best), angle(near.second));
    first <= f64::from(options.max_distance) && first < f64::from(options.max_ratio) * second
}

/// Returns for each feature the first feature at its place and scale.
fn spots(features: &Features) -> Vec<u32> {
    let place = |index: usize| {
        let point = features.keypoints.get(index)?;
        Some([point.x_px, point.y_px, point.scale_px].map(f32::to_bits))
    };
    let mut first = 0;
    let spot = |index: usize| {
        if place(index) != place(first) {
            first = index;
        }
        first as u32
    };
    (0..features.descriptors.len()).map(spot).collect()
}

/// Keeps the best hit of every spot on both sides, named by their first features.
fn one_a_spot(mut hits: Vec<Hit>, spots_a: &[u32], spots_b: &[u32]) -> Vec<[u32; 2]> {
    hits.sort_by_key(|&(dot, pair)| (std::cmp::Reverse(dot), pair));
    let mut taken = (vec![false; spots_a.len()], vec![false; spots_b.len()]);
    let mut pairs = Vec::with_capacity(hits.len());
    for (_, [a, b]) in hits {
        let (a, b) = (spots_a[a as usize], spots_b[b as usize]);
        if taken.0[a as usize] || taken.1[b as usize] {
            continue;
        }
        (taken.0[a as usize], taken.1[b as usize]) = (true, true);
        pairs.push([a, b]);
    }
    pairs.sort_unstable();
    pairs
}

#[cfg(test)]
mod tests;

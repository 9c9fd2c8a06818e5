//! Which pairs of photos to compare.

use rayon::prelude::*;

use super::match_pair::mutual;
use super::nearest::ColumnBlocks;
use crate::features::{Descriptor, Features};
use crate::simd::InstructionSet;

/// Features of the largest scales that represent a photo in retrieval.
const SAMPLE: usize = 256;

/// Returns pairs i < j, sorted: every photo with the next `overlap` and with those 2^k further on.
pub fn sequential(count: usize, overlap: usize) -> Vec<(usize, usize)> {
    let doubled = (0..usize::BITS).map(|power| 1_usize << power);
    let mut steps: Vec<usize> = (1..=overlap.min(count))
        .chain(doubled.take_while(|&step| step < count))
        .collect();
    steps.sort_unstable();
    steps.dedup();
    let pairs = (0..count).flat_map(|first| steps.iter().map(move |step| (first, first + step)));
    pairs.filter(|&(_, second)| second < count).collect()
}

/// Returns all pairs i < j, sorted.
pub fn exhaustive(count: usize) -> Vec<(usize, usize)> {
    (0..count)
        .flat_map(|first| (first + 1..count).map(move |second| (first, second)))
        .collect()
}

/// The 256 features of the largest scales of each photo.
pub struct Samples {
    descriptors: Vec<Vec<Descriptor>>,
    packed: Vec<ColumnBlocks>,
}

impl Samples {
    /// Takes the samples of all photos.
    pub fn new(all: &[&Features]) -> Self {
        let descriptors: Vec<Vec<Descriptor>> = all.par_iter().map(|features| largest(features)).collect();
        Self {
            packed: descriptors
                .par_iter()
                .map(|sample| ColumnBlocks::new(sample))
                .collect(),
            descriptors,
        }
    }

    /// Returns the number of matches of two photos.
    pub fn matches(&self, first: usize, second: usize) -> usize {
        let set = InstructionSet::best();
        mutual(set, &self.descriptors[first], &self.packed[second]).len()
    }
}

/// Returns for each of `count` photos the `per_photo` others with which it has most matches, as sorted pairs i < j.
///
/// `matches`: two photos and their number of matches. With fewer than `min_matches` they are not candidates. More
/// matches come first, ties by the lower index. A pair is returned if either photo chose it.
pub fn most_similar(
    count: usize,
    matches: &[([usize; 2], usize)],
    per_photo: usize,
    min_matches: usize,
) -> Vec<(usize, usize)> {
    let mut candidates = vec![Vec::new(); count];
    for &([first, second], matches) in matches
        .iter()
        .filter(|(_, matches)| *matches >= min_matches.max(1))
    {
        candidates[first].push((matches, second));
        candidates[second].push((matches, first));
    }
    let mut chosen: Vec<(usize, usize)> = Vec::new();
    for (photo, mut others) in candidates.into_iter().enumerate() {
        others.sort_by_key(|&(matches, other)| (std::cmp::Reverse(matches), other));
        let best = others.into_iter().take(per_photo);
        chosen.extend(best.map(|(_, other)| (photo.min(other), photo.max(other))));
    }
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

/// Returns the descriptors of the largest scales, ties by index.
fn largest(features: &Features) -> Vec<Descriptor> {
    let mut order: Vec<usize> = (0..features.keypoints.len().min(features.descriptors.len())).collect();
    let scale = |index: usize| features.keypoints[index].scale_px;
    order.sort_by(|&a, &b| scale(b).total_cmp(&scale(a)).then(a.cmp(&b)));
    order
        .into_iter()
        .take(SAMPLE)
        .map(|index| features.descriptors[index])
        .collect()
}

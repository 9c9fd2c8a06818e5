//! Which photos to compare.

use rayon::prelude::*;

use super::nearest::Packed;
use super::{MatchOptions, mutual};
use crate::features::{Descriptor, Features};
use crate::simd::Isa;

/// Features of the largest scales that stand for a photo.
const SAMPLE: usize = 256;

/// Returns photos i < j, sorted: every one with its next `overlap` and those 2^k further on.
pub(crate) fn sequential(count: usize, overlap: usize) -> Vec<(usize, usize)> {
    let doubled = (0..usize::BITS).map(|power| 1_usize << power);
    let mut steps: Vec<usize> = (1..=overlap.min(count))
        .chain(doubled.take_while(|&step| step < count))
        .collect();
    steps.sort_unstable();
    steps.dedup();
    let pairs = (0..count).flat_map(|first| steps.iter().map(move |step| (first, first + step)));
    pairs.filter(|&(_, second)| second < count).collect()
}

/// Returns all photos i < j, sorted.
pub(crate) fn exhaustive(count: usize) -> Vec<(usize, usize)> {
    (0..count)
        .flat_map(|first| (first + 1..count).map(move |second| (first, second)))
        .collect()
}

/// Returns for each photo the `per_photo` others whose largest-scale features match best, as sorted pairs i < j.
///
/// All pairs are matched with 256 features of each; one with fewer than `min_hits` matches is no candidate.
/// More hits come first, ties by the lower index. A pair is in the answer if either photo chose it.
pub(crate) fn retrieve(all: &[&Features], per_photo: usize, min_hits: usize) -> Vec<(usize, usize)> {
    let isa = Isa::best();
    let samples: Vec<Vec<Descriptor>> = all.par_iter().map(|features| largest(features)).collect();
    let packed: Vec<Packed> = samples.par_iter().map(|sample| Packed::new(sample)).collect();
    let options = MatchOptions::default();
    let pairs = exhaustive(all.len());
    let hits: Vec<usize> = pairs
        .par_iter()
        .map(|&(first, second)| mutual(isa, &samples[first], &packed[second], &options).len())
        .collect();
    let mut candidates = vec![Vec::new(); all.len()];
    for (&(first, second), hits) in pairs
        .iter()
        .zip(hits)
        .filter(|&(_, hits)| hits >= min_hits.max(1))
    {
        candidates[first].push((hits, second));
        candidates[second].push((hits, first));
    }
    let mut chosen: Vec<(usize, usize)> = Vec::new();
    for (photo, mut others) in candidates.into_iter().enumerate() {
        others.sort_by_key(|&(hits, other)| (std::cmp::Reverse(hits), other));
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

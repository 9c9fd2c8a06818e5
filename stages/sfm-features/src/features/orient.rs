//! Orientations of a keypoint.

use super::extrema::Extremum;
use super::gradient::{Gradient, exp_neg};

/// Bins of the histogram of directions.
const BINS: usize = 36;
/// Largest number of orientations of a keypoint.
const MOST: usize = 2;
/// Standard deviation of the window over that of the keypoint, and radius of the window over its standard deviation.
const WINDOW: f32 = 1.5;
const RADIUS: f32 = 3.0;
/// Smallest height of a further peak relative to the highest.
const NEXT: f32 = 0.8;

/// Returns the one or two dominant directions of a keypoint in eighths of a turn, in [0, 8). Empty if all is flat.
#[inline(always)]
pub(super) fn orientations(gradient: &Gradient, point: &Extremum) -> Vec<f32> {
    let bins = smooth(histogram(gradient, point));
    let greatest = bins.iter().copied().fold(0.0, f32::max);
    let around = |bin: usize| [bins[(bin + BINS - 1) % BINS], bins[bin], bins[(bin + 1) % BINS]];
    let is_peak = |&bin: &usize| {
        let [before, here, after] = around(bin);
        here > before && here > after && here >= NEXT * greatest
    };
    let mut peaks: Vec<usize> = (0..BINS).filter(is_peak).collect();
    peaks.sort_by(|&a, &b| bins[b].total_cmp(&bins[a]).then(a.cmp(&b)));
    let direction = |bin: usize| {
        let [before, here, after] = around(bin);
        // The vertex of the parabola. A peak has a curvature below 0.
        let by = 0.5 * (before - after) / (before - 2.0 * here + after);
        let eighths = (bin as f32 + by) * (8.0 / BINS as f32);
        if eighths < 0.0 { eighths + 8.0 } else { eighths }
    };
    peaks.into_iter().take(MOST).map(direction).collect()
}

/// Returns the histogram of directions in a Gaussian window. Each sample is shared by the two nearest bins.
#[inline(always)]
fn histogram(gradient: &Gradient, point: &Extremum) -> [f32; BINS] {
    let mut bins = [0.0; BINS];
    let sigma = WINDOW * point.sigma;
    let radius = RADIUS * sigma;
    let falloff = 0.5 / (sigma * sigma);
    let range = |at: f32, len: usize| {
        ((at - radius).ceil().max(1.0) as usize)..((at + radius + 1.0) as usize).min(len - 1)
    };
    for y in range(point.y, gradient.height) {
        let dy = y as f32 - point.y;
        for x in range(point.x, gradient.width) {
            let dx = x as f32 - point.x;
            let squared = dx * dx + dy * dy;
            if squared > radius * radius {
                continue;
            }
            let at = y * gradient.width + x;
            let weight = gradient.magnitude[at] * exp_neg(squared * falloff);
            let bin = gradient.eighths[at] * (BINS as f32 / 8.0);
            let (low, share) = (bin as usize, bin - (bin as usize) as f32);
            bins[low % BINS] += weight * (1.0 - share);
            bins[(low + 1) % BINS] += weight * share;
        }
    }
    bins
}

/// Returns the bins after six averages over three neighbours, as in VLFeat.
#[inline(always)]
fn smooth(mut bins: [f32; BINS]) -> [f32; BINS] {
    for _ in 0..6 {
        bins = std::array::from_fn(|bin| {
            (bins[(bin + BINS - 1) % BINS] + bins[bin] + bins[(bin + 1) % BINS]) * (1.0 / 3.0)
        });
    }
    bins
}

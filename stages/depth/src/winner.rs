//! The best candidate of each pixel, and whether both pictures agree on it.

use marf_numeric::InstructionSet;
use rayon::prelude::*;

use crate::cost::Volume;
use crate::kernel::{self, Kernel};
use crate::paths::PathCosts;
use crate::raster::Raster;
use crate::tuning;

/// A pixel without a disparity.
pub(crate) const NONE: f32 = f32::NEG_INFINITY;

/// A candidate and its cost in one number: the smaller of two is the cheaper, then the nearer to the first candidate.
const COST_SHIFT: u32 = 16;

/// Returns the disparity of each pixel, at most `last`, or [`NONE`] where the other picture disagrees.
///
/// Pixels that do not take part have none. Both disparities come from the same costs. They may differ by one pixel. Ties go to the smallest disparity.
/// The fraction is that of two lines of equal slope through three costs, exact to 1/512 px or better.
pub(crate) fn winners(set: InstructionSet, volume: &Volume, costs: &PathCosts, last: i32) -> Raster<f32> {
    let mut disparities = Raster::filled(volume.width, volume.height, NONE);
    disparities
        .values
        .par_chunks_mut(volume.width)
        .enumerate()
        .for_each(|(y, out)| {
            kernel::run(
                set,
                WinnerRow {
                    volume,
                    costs,
                    last,
                    y,
                    out,
                },
            );
        });
    disparities
}

struct WinnerRow<'a> {
    volume: &'a Volume,
    costs: &'a PathCosts,
    last: i32,
    y: usize,
    out: &'a mut [f32],
}

impl Kernel for WinnerRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Volume {
            width, candidates, ..
        } = *self.volume;
        let first = self.volume.first.row(self.y);
        // For each pixel of the other picture, from right to left, the best of those that point at it.
        let mut others = vec![u32::MAX; width + 2 * candidates];
        let lowest = first.iter().copied().min().unwrap_or(0);
        let mut keys = vec![0u32; candidates];
        let mut best = vec![u32::MAX; width];
        for x in 0..width {
            let start = (self.y * width + x) * candidates;
            let down = &self.costs.down[start..start + candidates];
            let up = &self.costs.up[start..start + candidates];
            let count = (self.last - first[x] + 1).clamp(0, candidates as i32) as usize;
            for (i, key) in keys.iter_mut().enumerate() {
                *key = ((u32::from(down[i]) + u32::from(up[i])) << COST_SHIFT) | i as u32;
            }
            keys[count..].fill(u32::MAX);
            let least = keys.iter().fold(u32::MAX, |best, &key| best.min(key));
            let (at, second) = ((least & 0xffff) as usize, least >> COST_SHIFT);
            let mut rival = u32::MAX;
            for (i, &key) in keys.iter().enumerate() {
                let near = i.abs_diff(at) <= 1;
                rival = rival.min(if near { u32::MAX } else { key });
            }
            rival >>= COST_SHIFT;
            let unique = count > 1 && rival > second + tuning::UNIQUE_MARGIN;
            best[x] = if unique { least } else { u32::MAX };
            let offset = (first[x] - lowest) as u32;
            let at = place(width, candidates, x, first[x]);
            for (other, &key) in others[at..at + candidates].iter_mut().zip(&keys) {
                *other = (*other).min(key.saturating_add(offset));
            }
        }
        for x in 0..width {
            let i = (best[x] & 0xffff) as i32;
            let disparity = first[x] + i;
            let at = x as i64 - i64::from(disparity);
            if best[x] == u32::MAX || at < 0 || at >= width as i64 {
                continue;
            }
            let [left, right] = &self.volume.usable;
            if !left.at(x, self.y) || !right.at(at as usize, self.y) {
                continue;
            }
            let other = (others[place(width, candidates, x, disparity)] & 0xffff) as i32 + lowest;
            if (other - disparity).abs() > 1 {
                continue;
            }
            let start = (self.y * width + x) * candidates;
            let cost = |i: usize| i32::from(self.costs.down[start + i]) + i32::from(self.costs.up[start + i]);
            let i = i as usize;
            let mut fraction = 0.0;
            if i > 0 && i + 1 < candidates && disparity < self.last {
                fraction = vertex(cost(i - 1) - cost(i), cost(i + 1) - cost(i));
            }
            self.out[x] = disparity as f32 + fraction;
        }
    }
}

/// Returns where the counterpart of `x` at `disparity` is, from right to left. What is outside is at an end.
#[inline(always)]
fn place(width: usize, candidates: usize, x: usize, disparity: i32) -> usize {
    let at = (candidates + width - 1 - x) as i64 + i64::from(disparity);
    at.clamp(0, (width + candidates) as i64) as usize
}

/// Returns where two lines of equal slope through three costs meet, in [-1/2, 1/2].
///
/// `before` and `after` are how much the neighbours cost more than the middle, not negative.
fn vertex(before: i32, after: i32) -> f32 {
    let steep = before.max(after);
    if steep <= 0 {
        return 0.0;
    }
    (before - after) as f32 / (2 * steep) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_lines_of_equal_slope_meet_where_three_costs_say() {
        // Equal sides: the middle. One side free: half a pixel towards it. 4 and 8: (4 - 8) / 16 to the left.
        assert_eq!(vertex(6, 6), 0.0);
        assert_eq!(vertex(0, 6), -0.5);
        assert_eq!(vertex(6, 0), 0.5);
        assert_eq!(vertex(4, 8), -0.25);
        assert_eq!(vertex(0, 0), 0.0);
    }
}

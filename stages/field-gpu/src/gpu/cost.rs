//! What dispatches of a step move, counted from the arrays that they are bound to: no clock, no estimate of a cache.
//!
//! A byte counts once a dispatch that reads it and once a dispatch that writes it, however often its threads ask for it.

use super::record::Work;
use super::tables::{EACH, ROWS};

/// How far the arrays of a batch are filled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BatchFill {
    /// Samples that rays visit.
    pub visited: f64,
    /// Samples that are trained.
    pub kept: f64,
    /// Rays.
    pub rays: f64,
    /// Rows of the tables that have a gradient, as a share of all.
    pub moved: f64,
    /// Corners that are added to the tables one by one, as a share of those of all samples: see [`apart`].
    pub apart: f64,
}

/// What a kernel does in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Its name.
    pub name: &'static str,
    /// Dispatches.
    pub dispatches: usize,
    /// Bytes read and written.
    pub bytes: f64,
    /// Additions to memory that other threads add to, too.
    pub atomics: f64,
}

/// Slots of the arrays of a batch.
#[derive(Clone, Copy, Debug)]
pub struct Slots {
    /// Samples a column.
    pub capacity: usize,
    /// Rays a column.
    pub rays: usize,
}

/// Returns the cost of each kernel of some dispatches, in their order. `None` where a kernel has no cost
/// here.
pub fn costs(work: &Work, slots: Slots, filled: &BatchFill) -> Option<Vec<Cost>> {
    let mut costs: Vec<Cost> = Vec::new();
    for bound in work.bounds() {
        let arrays = Arrays {
            sizes: &bound.sizes,
            slots,
            filled,
        };
        let (bytes, atomics) = arrays.moved(bound.name)?;
        match costs.iter_mut().find(|cost| cost.name == bound.name) {
            Some(cost) => {
                cost.dispatches += 1;
                cost.bytes += bytes;
                cost.atomics += atomics;
            }
            None => costs.push(Cost {
                name: bound.name,
                dispatches: 1,
                bytes,
                atomics,
            }),
        }
    }
    Some(costs)
}

/// The arrays of one dispatch, in the order of their bindings.
struct Arrays<'a> {
    sizes: &'a [u64],
    slots: Slots,
    filled: &'a BatchFill,
}

impl Arrays<'_> {
    /// Returns the bytes of some bindings.
    fn whole(&self, bindings: &[usize]) -> f64 {
        let sizes = bindings.iter().filter_map(|binding| self.sizes.get(*binding));
        sizes.sum::<u64>() as f64
    }

    fn visited(&self, bindings: &[usize]) -> f64 {
        self.whole(bindings) / self.slots.capacity as f64 * self.filled.visited
    }

    fn kept(&self, bindings: &[usize]) -> f64 {
        self.whole(bindings) / self.slots.capacity as f64 * self.filled.kept
    }

    fn rays(&self, bindings: &[usize]) -> f64 {
        self.whole(bindings) / self.slots.rays as f64 * self.filled.rays
    }

    /// Returns the neurons of the columns of a binding.
    fn rows(&self, binding: usize) -> f64 {
        self.whole(&[binding]) / (4 * self.slots.capacity) as f64
    }

    /// Returns lookups in the tables for `samples` samples: corners of all levels.
    fn corners(&self, levels: usize, samples: f64) -> f64 {
        8.0 * samples * self.whole(&[levels]) / size_of::<marf_shaders::GridLevel>() as f64
    }

    /// Returns bytes and atomic additions of a kernel.
    fn moved(&self, name: &str) -> Option<(f64, f64)> {
        let BatchFill {
            visited,
            kept,
            rays,
            moved,
            ..
        } = *self.filled;
        let bytes = match name {
            "rays" => self.rays(&[4, 5, 6, 7]) + 4.0 * rays,
            // Of the two entries `write` has the columns of samples.
            "march" if self.rows(7) < 6.0 => self.rays(&[1, 2, 7, 8]) + self.whole(&[3, 4]),
            "march" => self.rays(&[1, 2, 6]) + self.whole(&[3, 4]) + self.visited(&[7, 8]),
            "scan" => self.rays(&[1, 2]),
            "hash_encode" => {
                let row = self.rows(5) * 4.0 / self.corners(1, 1.0) * 8.0;
                let table = self.whole(&[4]).min(row * self.corners(1, visited));
                self.visited(&[3, 5]) + table
            }
            "density" => self.visited(&[2, 4]) + self.whole(&[3]),
            "shade" => self.kept(&[3, 4, 7]) + 64.0 * kept + self.rays(&[5]) + self.whole(&[6]),
            // Memory of a workgroup counts as any other, once a dispatch.
            "back" => {
                let columns = self.kept(&[2, 3, 4, 7, 9]);
                columns + self.rays(&[5]) + self.whole(&[6, 8, 8])
            }
            "sum" => self.whole(&[2, 3]),
            // Density, length and weight of all. The rest of `along` of the chosen ones.
            "opacity" => self.rays(&[2]) + 12.0 * rays + 32.0 * visited + 20.0 * kept,
            "kept" => self.rays(&[2]) + self.kept(&[4]) + 4.0 * kept,
            "compare" => self.rays(&[2, 5, 6, 9]) + 8.0 * kept + self.kept(&[4]) + rays / 64.0 * 256.0,
            "spread" => self.rays(&[2, 7]) + 20.0 * rays + self.kept(&[3, 9]) + 28.0 * kept,
            "scatter" | "scatter_packed" => self.kept(&[3, 4, 7]) + 2.0 * moved * self.whole(&[6]),
            "peak" => self.whole(&[1]),
            "rescale" => 2.0 * self.whole(&[1]),
            "adam_table" => {
                let follow = (1.0 - moved) * self.whole(&[6]) + self.whole(&[10, 10]);
                self.whole(&[5]) + moved * (self.whole(&[5]) + 2.0 * self.whole(&[6, 7, 8, 9])) + follow
            }
            "adam_net" => 2.0 * self.whole(&[4, 5, 6, 7, 8, 9]),
            "exposure_sums" => self.rays(&[2]) + 24.0 * rays + self.whole(&[4, 5]),
            "exposure_learn" => self.whole(&[2, 5, 5, 6, 6, 7, 7, 8, 8]),
            "totals" => 4.0 * rays,
            _ => return None,
        };
        let words = self.rows(4) / self.corners(1, 1.0) * 8.0;
        let atomics = match name {
            "scatter" => self.corners(1, kept) * words * self.filled.apart,
            "scatter_packed" => self.corners(1, kept) * words / 2.0 * self.filled.apart,
            "peak" => self.whole(&[1]) / 8.0 / (64 * ROWS) as f64,
            _ => 0.0,
        };
        Some((bytes, atomics))
    }
}

/// Returns the share of corners that samples, 8 at a time, add to the tables of some levels. A cell's
/// neighbour keeps the corners that both share: twin of the order of `shared/spread.wgsl`, where no sum is 0.
///
/// `samples`: positions in the unit box. `resolutions`: cells a side.
pub fn apart(samples: &[[f32; 3]], resolutions: &[u32]) -> f64 {
    let cell = |at: &[f32; 3], side: u32| at.map(|x| ((x * side as f32) as i64).min(i64::from(side) - 1));
    let mut added = 0;
    for side in resolutions {
        for run in samples.chunks(EACH) {
            for pair in run.windows(2) {
                let [from, to] = [&pair[0], &pair[1]].map(|at| cell(at, *side));
                let shared = (0..3).map(|axis| 2 - (to[axis] - from[axis]).abs().min(2));
                added += 8 - shared.product::<i64>();
            }
            added += 8;
        }
    }
    added as f64 / (8 * samples.len() * resolutions.len()).max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_that_neighbours_share_are_added_once() {
        let at = |x: f32| [x, 0.5, 0.5];
        // Eight samples of one cell, of two that share a face, of cells apart.
        assert_eq!(apart(&[at(0.1); 8], &[4]), 8.0 / 64.0);
        assert_eq!(apart(&[at(0.1), at(0.3)], &[4]), 12.0 / 16.0);
        assert_eq!(apart(&[at(0.1), at(0.9)], &[4, 1]), (16.0 + 8.0) / 32.0);
        // A run ends after eight.
        assert_eq!(apart(&[at(0.1); 9], &[4]), 16.0 / 72.0);
        assert_eq!(apart(&[], &[4]), 0.0);
    }
}

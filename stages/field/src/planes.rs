//! Features of samples: looked up level by level, `[levels, n, F]`, and as rows of a network's input, `[n, levels F]`.

use crate::cpu::encode::{Lookup, Points, Shape};
use crate::cpu::simd::{Block, InstructionSet, Isa, Kernel, LANES, Run, Stripe, flat, flat_mut};
use crate::weights::Weights;

/// A level of the hash grid.
#[derive(Clone, Copy)]
pub struct GridLevel<'a> {
    features: usize,
    shape: Shape,
    table: &'a [f32],
}

impl<'a> GridLevel<'a> {
    /// Returns a level with `features` numbers an entry. `table`: `[entries, features]`.
    pub fn new(features: usize, shape: Shape, table: &'a [f32]) -> Self {
        Self {
            features,
            shape,
            table,
        }
    }

    /// Looks the level up for all points.
    pub fn lookup(self, level: InstructionSet, points: Points, to: Stripe) {
        let Self {
            features,
            shape,
            table,
        } = self;
        match features {
            2 => level.run(Lookup::<2> {
                shape,
                table,
                points,
                to,
            }),
            _ => level.run(Lookup::<4> {
                shape,
                table,
                points,
                to,
            }),
        }
    }
}

/// Cuts `[levels, n, F]` into its levels.
pub fn planes_mut<'a>(planes: &'a mut [Block], weights: &Weights) -> impl Iterator<Item = &'a mut [Block]> {
    let plane = planes.len() / weights.shapes.len().max(1);
    planes.chunks_mut(plane.max(1))
}

/// From `[levels, n, F]` to `[n, levels F]`, n a multiple of 16.
pub struct ToRows<'a> {
    /// Level by level.
    pub planes: &'a [Block],
    /// Row by row.
    pub rows: &'a mut [Block],
    /// F.
    pub features: usize,
    /// Levels.
    pub levels: usize,
}

impl Kernel for ToRows<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let (planes, rows) = (flat(self.planes), flat_mut(self.rows));
        match self.features {
            2 => transpose::<2>(planes.as_chunks().0, rows.as_chunks_mut().0, self.levels),
            _ => transpose::<4>(planes.as_chunks().0, rows.as_chunks_mut().0, self.levels),
        }
    }
}

/// From `[n, levels F]` to `[levels, n, F]`, n a multiple of 16.
pub struct ToPlanes<'a> {
    /// Row by row.
    pub rows: &'a [Block],
    /// Level by level.
    pub planes: &'a mut [Block],
    /// F.
    pub features: usize,
    /// Levels.
    pub levels: usize,
}

impl Kernel for ToPlanes<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let (rows, planes) = (flat(self.rows), flat_mut(self.planes));
        let samples = rows.len() / (self.features * self.levels).max(1);
        match self.features {
            2 => transpose::<2>(rows.as_chunks().0, planes.as_chunks_mut().0, samples),
            _ => transpose::<4>(rows.as_chunks().0, planes.as_chunks_mut().0, samples),
        }
    }
}

/// Transposes a matrix of `rows` rows of entries of F numbers, 16 columns at a time: these stay in the first cache.
#[inline(always)]
fn transpose<const F: usize>(from: &[[f32; F]], to: &mut [[f32; F]], rows: usize) {
    let columns = from.len() / rows.max(1);
    for (block, to) in to.chunks_mut((LANES * rows).max(1)).enumerate() {
        for row in 0..rows {
            let from = &from[row * columns + block * LANES..];
            for (to, from) in to.chunks_exact_mut(rows).zip(from) {
                to[row] = *from;
            }
        }
    }
}

//! Sums of products whose places are checked once a tile.

use super::isa::{Block, Isa};

/// A matrix in numbers: element (row, step) is at `row * self.row + step * self.step`.
#[derive(Clone, Copy)]
pub struct Strided<'a> {
    /// The numbers.
    pub numbers: &'a [f32],
    /// Distance of two rows.
    pub row: usize,
    /// Distance of two steps of the sum.
    pub step: usize,
    /// Steps of the sum.
    pub steps: usize,
}

impl Strided<'_> {
    /// Leaves out the first rows.
    #[inline(always)]
    pub fn from_row(self, first: usize) -> Self {
        Self {
            numbers: &self.numbers[first * self.row..],
            ..self
        }
    }
}

/// Adds A B to the sums: MR rows of `a`, the first `NV` blocks of rows of `columns` blocks of `b`, in the order of
/// the steps.
#[inline(always)]
pub fn add_products<I: Isa, const MR: usize, const NV: usize>(
    isa: I,
    sums: &mut [[I::V; NV]; MR],
    a: Strided,
    b: &[Block],
    columns: usize,
) {
    let steps = a.steps;
    let reach = |count: usize, stride: usize| count.saturating_sub(1).saturating_mul(stride);
    // Once a tile instead of MR + NV times a step.
    assert!(reach(MR, a.row).saturating_add(reach(steps, a.step)) < a.numbers.len());
    assert!(reach(steps, columns).saturating_add(NV) <= b.len());
    let mut held = *sums;
    for step in 0..steps {
        let mut right = [isa.splat(0.0); NV];
        for v in 0..NV {
            // SAFETY: step < steps and v < NV, whose greatest place was compared with the length.
            right[v] = isa.load(unsafe { b.get_unchecked(step * columns + v) });
        }
        for row in 0..MR {
            // SAFETY: row < MR and step < steps, whose greatest place was compared with the length.
            let x = isa.splat(unsafe { *a.numbers.get_unchecked(row * a.row + step * a.step) });
            for v in 0..NV {
                held[row][v] = isa.mul_add(x, right[v], held[row][v]);
            }
        }
    }
    *sums = held;
}

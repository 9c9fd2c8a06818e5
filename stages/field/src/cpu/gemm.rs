//! The three products of a layer, by one register-blocked micro kernel.
//!
//! Rows are samples, columns are neurons in blocks of 16. Every output is one chain of fused multiply-adds in
//! the order of the summed index, whatever the blocking: hence the same bits on every instruction set.

use super::simd::{Block, Isa, Kernel, LANES, Strided, add_products, flat};

/// Samples whose gradients are added to all weights before the next ones are read: 256 rows of 64 numbers are
/// 64 KB, and stay in the second-level cache together with their inputs.
const SLAB: usize = 256;

/// What is done to a finished sum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum After<'a> {
    /// Added to the sums already there: the chain continues.
    Added,
    /// Stored as it is.
    Nothing,
    /// Negative sums become 0.
    Relu,
    /// Becomes 0 unless the number here, of the shape of C, is above 0: the slope of a ReLU.
    Gate(&'a [Block]),
}

/// C = A B of the first `steps` columns of A and the first `columns` block columns of B. n is a multiple of
/// 16.
pub struct Product<'a> {
    /// Left factor, `[n, inner]`.
    pub a: &'a [Block],
    /// Right factor, `[inner, across blocks]`.
    pub b: &'a [Block],
    /// Product, `[n, columns blocks]`.
    pub c: &'a mut [Block],
    /// Numbers in a row of A, a multiple of 16.
    pub inner: usize,
    /// Numbers in a row of A that are summed: the first ones, at most `inner`.
    pub steps: usize,
    /// Blocks in a row of B.
    pub across: usize,
    /// Blocks in a row of C, at most `across`.
    pub columns: usize,
    /// What happens to the sums.
    pub after: After<'a>,
}

impl Kernel for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        // A width known to the compiler makes the addresses of 16 rows one register and 16 constants.
        match (self.inner, self.steps) {
            (16, 16) => self.wide::<I>(isa, 16, 16),
            (32, 32) => self.wide::<I>(isa, 32, 32),
            (64, 64) => self.wide::<I>(isa, 64, 64),
            (16, steps) => self.wide::<I>(isa, 16, steps),
            (inner, steps) => self.wide::<I>(isa, inner, steps),
        }
    }
}

impl Product<'_> {
    #[inline(always)]
    fn wide<I: Isa>(self, isa: I, inner: usize, steps: usize) {
        let tiles = Tiles {
            a: Strided {
                numbers: flat(self.a),
                row: inner,
                step: 1,
                steps,
            },
            b: self.b,
            across: self.across,
            c: self.c,
            columns: self.columns,
            after: self.after,
        };
        tiles.run(isa);
    }
}

/// G = A^T D: `a` [n, k], `d` [n, m / 16 blocks], `g` [k, m / 16 blocks], summed over n in order.
pub struct Outer<'a> {
    /// Inputs of the layer, rows of `inner / 16` blocks.
    pub a: &'a [Block],
    /// Gradients of its outputs, rows of `columns` blocks.
    pub d: &'a [Block],
    /// Gradient of the weights, overwritten.
    pub g: &'a mut [Block],
    /// k, a multiple of 16.
    pub inner: usize,
    /// m / 16.
    pub columns: usize,
}

impl Kernel for Outer<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        self.g.fill(Block::ZERO);
        let a = self.a.chunks(SLAB * self.inner / LANES);
        for (a, d) in a.zip(self.d.chunks(SLAB * self.columns)) {
            let tiles = Tiles {
                a: Strided {
                    numbers: flat(a),
                    row: 1,
                    step: self.inner,
                    steps: d.len() / self.columns,
                },
                b: d,
                across: self.columns,
                c: self.g,
                columns: self.columns,
                after: After::Added,
            };
            tiles.run(isa);
        }
    }
}

/// C = A B or C += A B, tile by tile. The number of rows of C is a multiple of 16.
struct Tiles<'a> {
    a: Strided<'a>,
    b: &'a [Block],
    across: usize,
    c: &'a mut [Block],
    columns: usize,
    after: After<'a>,
}

impl Tiles<'_> {
    #[inline(always)]
    fn run<I: Isa>(mut self, isa: I) {
        let mut column = 0;
        while column < self.columns {
            let left = self.columns - column;
            column += match (I::WIDE, left) {
                (true, 4..) => self.panel::<I, 4, 4>(isa, column),
                (true, 2..) => self.panel::<I, 8, 2>(isa, column),
                (true, _) => self.panel::<I, 16, 1>(isa, column),
                (false, 2..) => self.panel::<I, 2, 2>(isa, column),
                (false, _) => self.panel::<I, 4, 1>(isa, column),
            };
        }
    }

    /// Computes all rows of `NV` block columns, `MR` rows at a time, and returns `NV`.
    #[inline(always)]
    fn panel<I: Isa, const MR: usize, const NV: usize>(&mut self, isa: I, column: usize) -> usize {
        for first in (0..self.c.len() / self.columns).step_by(MR) {
            let mut sums = [[isa.splat(0.0); NV]; MR];
            if matches!(self.after, After::Added) {
                for row in 0..MR {
                    let c = &self.c[(first + row) * self.columns + column..][..NV];
                    for v in 0..NV {
                        sums[row][v] = isa.load(&c[v]);
                    }
                }
            }
            let a = self.a.from_row(first);
            add_products(isa, &mut sums, a, &self.b[column..], self.across);
            for row in 0..MR {
                let at = (first + row) * self.columns + column;
                let c = &mut self.c[at..][..NV];
                for v in 0..NV {
                    let sum = match self.after {
                        After::Added | After::Nothing => sums[row][v],
                        After::Relu => isa.relu(sums[row][v]),
                        After::Gate(open) => isa.gate(sums[row][v], isa.load(&open[at + v])),
                    };
                    isa.store(sum, &mut c[v]);
                }
            }
        }
        NV
    }
}

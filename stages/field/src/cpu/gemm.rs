//! The three products of a layer, by one register-blocked micro kernel each.
//!
//! Rows are samples, columns are neurons in blocks of 16. Every output is one chain of fused multiply-adds in
//! the order of the summed index, whatever the blocking: hence the same bits on every instruction set.

use super::simd::{Block, Isa, Kernel, flat};

/// What is done to a finished sum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum After<'a> {
    /// Stored as it is.
    Nothing,
    /// Negative sums become 0.
    Relu,
    /// Becomes 0 unless the number here, of the shape of C, is above 0: the slope of a ReLU.
    Gate(&'a [Block]),
}

/// C = A B: `a` [n, k], `b` [k, m / 16 blocks], `c` [n, m / 16 blocks]; n is a multiple of 16.
pub struct Product<'a> {
    /// Left factor, rows of `inner / 16` blocks.
    pub a: &'a [Block],
    /// Right factor, rows of `columns` blocks.
    pub b: &'a [Block],
    /// Product, rows of `columns` blocks.
    pub c: &'a mut [Block],
    /// k, a multiple of 16.
    pub inner: usize,
    /// m / 16.
    pub columns: usize,
    /// What happens to the sums.
    pub after: After<'a>,
}

impl Kernel for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(mut self, isa: I) {
        let mut column = 0;
        while column < self.columns {
            let left = self.columns - column;
            if left >= 4 && I::WIDE {
                self.panel::<I, 4, 4>(isa, column);
                column += 4;
            } else if left >= 2 {
                if I::WIDE {
                    self.panel::<I, 8, 2>(isa, column);
                } else {
                    self.panel::<I, 2, 2>(isa, column);
                }
                column += 2;
            } else {
                if I::WIDE {
                    self.panel::<I, 16, 1>(isa, column);
                } else {
                    self.panel::<I, 4, 1>(isa, column);
                }
                column += 1;
            }
        }
    }
}

impl Product<'_> {
    /// All rows of `NV` block columns, `MR` rows at a time.
    #[inline(always)]
    fn panel<I: Isa, const MR: usize, const NV: usize>(&mut self, isa: I, column: usize) {
        let a = flat(self.a);
        let rows = self.c.len() / self.columns;
        for first in (0..rows).step_by(MR) {
            let mut sums = [[isa.splat(0.0); NV]; MR];
            let mut left = [&a[..0]; MR];
            for (row, left) in left.iter_mut().enumerate() {
                *left = &a[(first + row) * self.inner..][..self.inner];
            }
            for k in 0..self.inner {
                let b: &[Block] = &self.b[k * self.columns + column..][..NV];
                let mut right = [isa.splat(0.0); NV];
                for v in 0..NV {
                    right[v] = isa.load(&b[v]);
                }
                for row in 0..MR {
                    let x = isa.splat(left[row][k]);
                    for v in 0..NV {
                        sums[row][v] = isa.mul_add(x, right[v], sums[row][v]);
                    }
                }
            }
            for (row, sums) in sums.iter().enumerate() {
                let at = (first + row) * self.columns + column;
                let c = &mut self.c[at..][..NV];
                for v in 0..NV {
                    let sum = match self.after {
                        After::Nothing => sums[v],
                        After::Relu => isa.relu(sums[v]),
                        After::Gate(open) => isa.gate(sums[v], isa.load(&open[at + v])),
                    };
                    isa.store(sum, &mut c[v]);
                }
            }
        }
    }
}

/// G = A^T D: `a` [n, k], `d` [n, m / 16 blocks], `g` [k, m / 16 blocks], summed over n in order.
pub struct Outer<'a> {
    /// Inputs of the layer, rows of `inner / 16` blocks.
    pub a: &'a [Block],
    /// Gradients of its outputs, rows of `columns` blocks.
    pub d: &'a [Block],
    /// Gradient of the weights; overwritten.
    pub g: &'a mut [Block],
    /// k, a multiple of 16.
    pub inner: usize,
    /// m / 16.
    pub columns: usize,
}

impl Kernel for Outer<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(mut self, isa: I) {
        let mut column = 0;
        while column < self.columns {
            let left = self.columns - column;
            if left >= 4 && I::WIDE {
                self.panel::<I, 4, 4>(isa, column);
                column += 4;
            } else if left >= 2 {
                if I::WIDE {
                    self.panel::<I, 8, 2>(isa, column);
                } else {
                    self.panel::<I, 2, 2>(isa, column);
                }
                column += 2;
            } else {
                if I::WIDE {
                    self.panel::<I, 16, 1>(isa, column);
                } else {
                    self.panel::<I, 4, 1>(isa, column);
                }
                column += 1;
            }
        }
    }
}

impl Outer<'_> {
    #[inline(always)]
    fn panel<I: Isa, const MR: usize, const NV: usize>(&mut self, isa: I, column: usize) {
        let a = flat(self.a);
        for first in (0..self.inner).step_by(MR) {
            let mut sums = [[isa.splat(0.0); NV]; MR];
            for (a, d) in a.chunks_exact(self.inner).zip(self.d.chunks_exact(self.columns)) {
                let (a, d) = (&a[first..][..MR], &d[column..][..NV]);
                let mut right = [isa.splat(0.0); NV];
                for v in 0..NV {
                    right[v] = isa.load(&d[v]);
                }
                for row in 0..MR {
                    let x = isa.splat(a[row]);
                    for v in 0..NV {
                        sums[row][v] = isa.mul_add(x, right[v], sums[row][v]);
                    }
                }
            }
            for (row, sums) in sums.iter().enumerate() {
                for v in 0..NV {
                    isa.store(sums[v], &mut self.g[(first + row) * self.columns + column + v]);
                }
            }
        }
    }
}

//! Vectors of 16 lanes and the operations on them, whatever the instruction set.

use std::marker::PhantomData;

use marf_numeric::InstructionSet;

/// Lanes of one vector, on every set.
pub const LANES: usize = 16;

/// One vector in memory, aligned to a cache line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(64))]
pub struct Block(pub [f32; LANES]);

impl Block {
    /// All zero.
    pub const ZERO: Self = Self([0.0; LANES]);
}

/// Views blocks as their numbers.
pub fn flat(blocks: &[Block]) -> &[f32] {
    // SAFETY: Block is repr(C) of 16 f32 in 64 bytes without padding. The length is in bounds.
    unsafe { std::slice::from_raw_parts(blocks.as_ptr().cast(), blocks.len() * LANES) }
}

/// Views blocks as their numbers.
pub fn flat_mut(blocks: &mut [Block]) -> &mut [f32] {
    // SAFETY: as in `flat`. The borrow is exclusive.
    unsafe { std::slice::from_raw_parts_mut(blocks.as_mut_ptr().cast(), blocks.len() * LANES) }
}

/// A stripe of columns of a matrix of rows. One task may write it while others write the neighbouring
/// columns.
pub struct Stripe<'a> {
    first: *mut f32,
    rows: usize,
    /// Numbers from a row to the next.
    stride: usize,
    /// Columns.
    columns: usize,
    matrix: PhantomData<&'a mut [Block]>,
}

// SAFETY: a stripe is the only one to reach its columns, as an exclusive borrow would be.
unsafe impl Send for Stripe<'_> {}

impl<'a> Stripe<'a> {
    /// Cuts rows of `width` blocks into stripes of `columns` columns, from the left. The rest of a row that
    /// is narrower than a stripe is in no stripe.
    pub fn cut(rows: &'a mut [Block], width: usize, columns: usize) -> Vec<Self> {
        let stride = width * LANES;
        let count = rows.len() / width.max(1);
        let first = rows.as_mut_ptr().cast::<f32>();
        let stripes = (0..stride / columns.max(1)).map(|stripe| Self {
            // SAFETY: the last column of the last stripe is below `stride`, hence in the first row. Without
            // rows the pointer is never read.
            first: if count == 0 {
                first
            } else {
                unsafe { first.add(stripe * columns) }
            },
            rows: count,
            stride,
            columns,
            matrix: PhantomData,
        });
        stripes.collect()
    }

    /// Returns a whole matrix of rows of `columns` numbers, one behind the other.
    pub fn plane(rows: &'a mut [Block], columns: usize) -> Self {
        Self {
            first: rows.as_mut_ptr().cast::<f32>(),
            rows: rows.len() * LANES / columns.max(1),
            stride: columns,
            columns,
            matrix: PhantomData,
        }
    }

    /// Writes 16 rows from row `first` on, each as soon as it is computed. Rows kept for later would be
    /// gathered number by number across lanes, at a third of the speed.
    ///
    /// # Panics
    /// If the rows or the columns do not exist: a mistake of the caller.
    #[inline(always)]
    pub fn fill<const F: usize>(&mut self, first: usize, value: impl Fn(usize) -> [f32; F]) {
        assert!(F == self.columns && first + LANES <= self.rows);
        for lane in 0..LANES {
            // SAFETY: row and columns are in bounds (asserted), and no other stripe has these columns.
            unsafe {
                let to = self.first.add((first + lane) * self.stride);
                to.cast::<[f32; F]>().write(value(lane));
            }
        }
    }
}

/// The operations that plain loops are not reliably compiled to.
pub trait Isa: Copy + Send + Sync {
    /// 16 lanes.
    type V: Copy;
    /// 16 lanes of u32.
    type U: Copy;
    /// Whether 16 accumulators and their operands fit the registers.
    const WIDE: bool;
    /// Returns 16 lanes of one value.
    fn splat(self, value: f32) -> Self::V;
    /// Reads 16 lanes.
    fn load(self, from: &Block) -> Self::V;
    /// Writes 16 lanes.
    fn store(self, value: Self::V, to: &mut Block);
    /// Returns a b + c, rounded once.
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// Returns 0 where 0 > x, else x: keeps a NaN.
    fn relu(self, value: Self::V) -> Self::V;
    /// Returns x where gate > 0, else 0.
    fn gate(self, value: Self::V, gate: Self::V) -> Self::V;
    /// Returns a b.
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// Returns a - b.
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    /// Cuts to [0, 1]. NaN becomes 0.
    fn unit(self, value: Self::V) -> Self::V;
    /// Returns the integer towards zero, of 0 <= x < 2^31.
    fn whole(self, value: Self::V) -> Self::U;
    /// Returns the integer as a float, for x < 2^31.
    fn float(self, value: Self::U) -> Self::V;
    /// Returns the bits of floats.
    fn bits(self, value: Self::V) -> Self::U;
    /// Returns 16 lanes of one value.
    fn splat_u(self, value: u32) -> Self::U;
    /// Writes 16 lanes.
    fn store_u(self, value: Self::U, to: &mut [u32; LANES]);
    /// Returns the sum, modulo 2^32.
    fn add_u(self, a: Self::U, b: Self::U) -> Self::U;
    /// Returns the product, modulo 2^32.
    fn mul_u(self, a: Self::U, b: Self::U) -> Self::U;
    /// Returns the bits that differ.
    fn xor_u(self, a: Self::U, b: Self::U) -> Self::U;
    /// Returns the bits that both have.
    fn and_u(self, a: Self::U, b: Self::U) -> Self::U;
    /// Returns the lesser.
    fn min_u(self, a: Self::U, b: Self::U) -> Self::U;
    /// Returns the greater.
    fn max_u(self, a: Self::U, b: Self::U) -> Self::U;
    /// Writes the lanes whose bit is set to the front, in order, and 0 behind them.
    fn pack(self, value: Self::V, lanes: u16, to: &mut [f32; LANES]);
}

/// Work that is compiled once a set. `run` and all it calls must be `#[inline(always)]`.
pub trait Kernel {
    /// What the kernel returns.
    type Output;
    /// Runs the kernel on a set.
    fn run<I: Isa>(self, isa: I) -> Self::Output;
}

/// Runs kernels on an instruction set.
pub trait Run {
    /// Runs a kernel on this set.
    fn run<K: Kernel>(self, kernel: K) -> K::Output;
}

impl Run for InstructionSet {
    fn run<K: Kernel>(self, kernel: K) -> K::Output {
        self.dispatch(Dispatched(kernel))
    }
}

marf_numeric::dispatch_kernels!(Kernel, |kernel, token| kernel.run(token));

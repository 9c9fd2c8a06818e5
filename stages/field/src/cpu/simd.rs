//! The only room with `unsafe` (this file and its folder): 16 lanes of f32 on AVX-512, AVX2 and plain Rust.
//!
//! A token ([`Avx2`], [`Avx512`]) is proof that this machine has the instructions: only detection makes one,
//! hence the methods that need them are safe. A [`Kernel`] is compiled once a set; all its functions are
//! `#[inline(always)]`, so that its plain loops are compiled with the set's instructions too. Every set rounds
//! every lane alike (IEEE 754 fused multiply-add), so the bits are the same.
#![allow(unsafe_code)]

mod sums;
mod table;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use sums::{Strided, add_products};
pub use table::{Checked, CheckedMut, Indices, Table, TableMut};

use std::marker::PhantomData;

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
    // SAFETY: Block is repr(C) of 16 f32 in 64 bytes without padding; the length is in bounds.
    unsafe { std::slice::from_raw_parts(blocks.as_ptr().cast(), blocks.len() * LANES) }
}

/// Views blocks as their numbers.
pub fn flat_mut(blocks: &mut [Block]) -> &mut [f32] {
    // SAFETY: as in `flat`; the borrow is exclusive.
    unsafe { std::slice::from_raw_parts_mut(blocks.as_mut_ptr().cast(), blocks.len() * LANES) }
}

/// A stripe of columns of a matrix of rows: what one task may write while others write the columns beside it.
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
    /// Cuts rows of `width` blocks into stripes of `columns` columns, from the left; the rest of a row that is
    /// narrower than a stripe belongs to none.
    pub fn cut(rows: &'a mut [Block], width: usize, columns: usize) -> Vec<Self> {
        let stride = width * LANES;
        let count = rows.len() / width.max(1);
        let first = rows.as_mut_ptr().cast::<f32>();
        let stripes = (0..stride / columns.max(1)).map(|stripe| Self {
            // SAFETY: the last column of the last stripe is below `stride`, hence in the first row, or there is
            // no row and the pointer is never read.
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

    /// Writes 16 rows from row `first` on, each as soon as it is known: kept for later, rows would be gathered
    /// number by number across lanes, at a third of the speed.
    ///
    /// # Panics
    /// Where the rows or the columns are not there: a mistake of the caller.
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
    /// All lanes the same.
    fn splat(self, value: f32) -> Self::V;
    /// Reads 16 lanes.
    fn load(self, from: &Block) -> Self::V;
    /// Writes 16 lanes.
    fn store(self, value: Self::V, to: &mut Block);
    /// a b + c, rounded once.
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// 0 where 0 > x, else x: keeps a NaN.
    fn relu(self, value: Self::V) -> Self::V;
    /// x where gate > 0, else 0.
    fn gate(self, value: Self::V, gate: Self::V) -> Self::V;
    /// a b.
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// a - b.
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    /// Cut to [0, 1]; NaN becomes 0.
    fn unit(self, value: Self::V) -> Self::V;
    /// The integer towards zero, of 0 <= x < 2^31.
    fn whole(self, value: Self::V) -> Self::U;
    /// As a float, of x < 2^31.
    fn float(self, value: Self::U) -> Self::V;
    /// All lanes the same.
    fn splat_u(self, value: u32) -> Self::U;
    /// Writes 16 lanes.
    fn store_u(self, value: Self::U, to: &mut [u32; LANES]);
    /// The sum, modulo 2^32.
    fn add_u(self, a: Self::U, b: Self::U) -> Self::U;
    /// The product, modulo 2^32.
    fn mul_u(self, a: Self::U, b: Self::U) -> Self::U;
    /// Bits that differ.
    fn xor_u(self, a: Self::U, b: Self::U) -> Self::U;
    /// Bits of both.
    fn and_u(self, a: Self::U, b: Self::U) -> Self::U;
    /// The lesser.
    fn min_u(self, a: Self::U, b: Self::U) -> Self::U;
    /// The greater.
    fn max_u(self, a: Self::U, b: Self::U) -> Self::U;
    /// Moves the lanes whose bit is set to the front, in order; the rest is 0.
    #[inline(always)]
    fn pack(self, value: Self::V, lanes: u16) -> Self::V {
        let (mut from, mut to, mut next) = (Block::ZERO, Block::ZERO, 0);
        self.store(value, &mut from);
        for lane in (0..LANES).filter(|lane| lanes >> lane & 1 == 1) {
            to.0[next] = from.0[lane];
            next += 1;
        }
        self.load(&to)
    }
}

/// Work that is compiled once a set. `run` and all it calls must be `#[inline(always)]`.
pub trait Kernel {
    /// What it answers.
    type Output;
    /// The body.
    fn run<I: Isa>(self, isa: I) -> Self::Output;
}

/// Plain Rust.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plain;

/// Proof of AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Avx2(());

/// Proof of AVX-512 F, BW, DQ, VL beside AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Avx512(());

/// The instruction set a kernel runs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Plain Rust; slow where fused multiply-add is a library call.
    Plain(Plain),
    /// 8 lanes an instruction.
    #[cfg(target_arch = "x86_64")]
    Avx2(Avx2),
    /// 16 lanes an instruction.
    #[cfg(target_arch = "x86_64")]
    Avx512(Avx512),
}

impl Level {
    /// Returns every set of this machine, slowest first.
    pub fn all() -> Vec<Self> {
        let mut levels = vec![Self::Plain(Plain)];
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            if avx2 {
                levels.push(Self::Avx2(Avx2(())));
            }
            let wide = is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bw");
            let long = is_x86_feature_detected!("avx512dq") && is_x86_feature_detected!("avx512vl");
            if avx2 && wide && long {
                levels.push(Self::Avx512(Avx512(())));
            }
        }
        levels
    }

    /// Returns the fastest set of this machine.
    pub fn best() -> Self {
        Self::all().pop().unwrap_or(Self::Plain(Plain))
    }

    /// Runs a kernel on this set.
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self {
            Self::Plain(isa) => kernel.run(isa),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the token was made by detection.
            Self::Avx2(isa) => unsafe { on_avx2(kernel, isa) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the token was made by detection.
            Self::Avx512(isa) => unsafe { on_avx512(kernel, isa) },
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,bmi2")]
fn on_avx2<K: Kernel>(kernel: K, isa: Avx2) -> K::Output {
    kernel.run(isa)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi2")]
fn on_avx512<K: Kernel>(kernel: K, isa: Avx512) -> K::Output {
    kernel.run(isa)
}

/// Lane by lane.
#[inline(always)]
fn each<T: Copy, R: Copy + Default>(a: [T; LANES], b: [T; LANES], work: fn(T, T) -> R) -> [R; LANES] {
    let mut found = [R::default(); LANES];
    for lane in 0..LANES {
        found[lane] = work(a[lane], b[lane]);
    }
    found
}

impl Isa for Plain {
    type V = [f32; LANES];
    type U = [u32; LANES];
    const WIDE: bool = false;

    #[inline(always)]
    fn splat(self, value: f32) -> Self::V {
        [value; LANES]
    }
    #[inline(always)]
    fn load(self, from: &Block) -> Self::V {
        from.0
    }
    #[inline(always)]
    fn store(self, value: Self::V, to: &mut Block) {
        to.0 = value;
    }
    #[inline(always)]
    fn mul_add(self, a: Self::V, b: Self::V, mut c: Self::V) -> Self::V {
        for lane in 0..LANES {
            c[lane] = a[lane].mul_add(b[lane], c[lane]);
        }
        c
    }
    #[inline(always)]
    fn relu(self, mut value: Self::V) -> Self::V {
        for lane in &mut value {
            *lane = if 0.0 > *lane { 0.0 } else { *lane };
        }
        value
    }
    #[inline(always)]
    fn gate(self, mut value: Self::V, gate: Self::V) -> Self::V {
        for lane in 0..LANES {
            value[lane] = if gate[lane] > 0.0 { value[lane] } else { 0.0 };
        }
        value
    }
    #[inline(always)]
    fn mul(self, a: Self::V, b: Self::V) -> Self::V {
        each(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn sub(self, a: Self::V, b: Self::V) -> Self::V {
        each(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn unit(self, value: Self::V) -> Self::V {
        let above = each(value, [0.0; LANES], |x, zero| if x > zero { x } else { zero });
        each(above, [1.0; LANES], |x, one| if x < one { x } else { one })
    }
    #[inline(always)]
    fn whole(self, value: Self::V) -> Self::U {
        each(value, value, |x, _| x as u32)
    }
    #[inline(always)]
    fn float(self, value: Self::U) -> Self::V {
        each(value, value, |x, _| x as f32)
    }
    #[inline(always)]
    fn splat_u(self, value: u32) -> Self::U {
        [value; LANES]
    }
    #[inline(always)]
    fn store_u(self, value: Self::U, to: &mut [u32; LANES]) {
        *to = value;
    }
    #[inline(always)]
    fn add_u(self, a: Self::U, b: Self::U) -> Self::U {
        each(a, b, u32::wrapping_add)
    }
    #[inline(always)]
    fn mul_u(self, a: Self::U, b: Self::U) -> Self::U {
        each(a, b, u32::wrapping_mul)
    }
    #[inline(always)]
    fn xor_u(self, a: Self::U, b: Self::U) -> Self::U {
        each(a, b, |a, b| a ^ b)
    }
    #[inline(always)]
    fn and_u(self, a: Self::U, b: Self::U) -> Self::U {
        each(a, b, |a, b| a & b)
    }
    #[inline(always)]
    fn min_u(self, a: Self::U, b: Self::U) -> Self::U {
        each(a, b, u32::min)
    }
    #[inline(always)]
    fn max_u(self, a: Self::U, b: Self::U) -> Self::U {
        each(a, b, u32::max)
    }
}

//! The only room with `unsafe`: 16 lanes of f32 on AVX-512, AVX2 and plain Rust.
//!
//! A token ([`Avx2`], [`Avx512`]) is proof that this machine has the instructions: only detection makes one,
//! hence the methods that need them are safe. A [`Kernel`] is compiled once a set; all its functions are
//! `#[inline(always)]`, so that its plain loops are compiled with the set's instructions too. Every set rounds
//! every lane alike (IEEE 754 fused multiply-add), so the bits are the same.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;
use std::marker::PhantomData;

/// Lanes of one vector, on every set.
pub const LANES: usize = 16;

/// One vector in memory, aligned to a cache line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(64))]
pub struct Block(pub [f32; LANES]);

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

    /// Writes 16 rows from row `first` on.
    ///
    /// # Panics
    /// Where the rows or the columns are not there: a mistake of the caller.
    #[inline(always)]
    pub fn set<const F: usize>(&mut self, first: usize, values: &[[f32; F]; LANES]) {
        assert!(F == self.columns && first + LANES <= self.rows);
        for (lane, values) in values.iter().enumerate() {
            // SAFETY: row and columns are in bounds (asserted), and no other stripe has these columns.
            unsafe {
                let to = self.first.add((first + lane) * self.stride);
                to.cast::<[f32; F]>().write(*values);
            }
        }
    }
}

/// The operations that plain loops are not reliably compiled to.
pub trait Isa: Copy + Send + Sync {
    /// 16 lanes.
    type V: Copy;
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

impl Isa for Plain {
    type V = [f32; LANES];
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
}

#[cfg(target_arch = "x86_64")]
impl Isa for Avx2 {
    type V = [__m256; 2];
    const WIDE: bool = false;

    #[inline(always)]
    fn splat(self, value: f32) -> Self::V {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_set1_ps(value); 2] }
    }
    #[inline(always)]
    fn load(self, from: &Block) -> Self::V {
        let at = from.0.as_ptr();
        // SAFETY: self proves AVX2; a block is 16 f32, aligned to 64 bytes.
        unsafe { [_mm256_load_ps(at), _mm256_load_ps(at.add(8))] }
    }
    #[inline(always)]
    fn store(self, value: Self::V, to: &mut Block) {
        let at = to.0.as_mut_ptr();
        // SAFETY: as in `load`; the borrow is exclusive.
        unsafe {
            _mm256_store_ps(at, value[0]);
            _mm256_store_ps(at.add(8), value[1]);
        }
    }
    #[inline(always)]
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        // SAFETY: self proves FMA.
        unsafe {
            [
                _mm256_fmadd_ps(a[0], b[0], c[0]),
                _mm256_fmadd_ps(a[1], b[1], c[1]),
            ]
        }
    }
    #[inline(always)]
    fn relu(self, value: Self::V) -> Self::V {
        // SAFETY: self proves AVX2. The second operand is returned where either is NaN.
        unsafe {
            let zero = _mm256_setzero_ps();
            [_mm256_max_ps(zero, value[0]), _mm256_max_ps(zero, value[1])]
        }
    }
    #[inline(always)]
    fn gate(self, value: Self::V, gate: Self::V) -> Self::V {
        // SAFETY: self proves AVX2. An ordered comparison with NaN is false.
        unsafe {
            let zero = _mm256_setzero_ps();
            let low = _mm256_cmp_ps::<_CMP_GT_OQ>(gate[0], zero);
            let high = _mm256_cmp_ps::<_CMP_GT_OQ>(gate[1], zero);
            [_mm256_and_ps(low, value[0]), _mm256_and_ps(high, value[1])]
        }
    }
}

#[cfg(target_arch = "x86_64")]
impl Isa for Avx512 {
    type V = __m512;
    const WIDE: bool = true;

    #[inline(always)]
    fn splat(self, value: f32) -> Self::V {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_set1_ps(value) }
    }
    #[inline(always)]
    fn load(self, from: &Block) -> Self::V {
        // SAFETY: self proves AVX-512 F; a block is 16 f32, aligned to 64 bytes.
        unsafe { _mm512_load_ps(from.0.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, value: Self::V, to: &mut Block) {
        // SAFETY: as in `load`; the borrow is exclusive.
        unsafe { _mm512_store_ps(to.0.as_mut_ptr(), value) }
    }
    #[inline(always)]
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_fmadd_ps(a, b, c) }
    }
    #[inline(always)]
    fn relu(self, value: Self::V) -> Self::V {
        // SAFETY: self proves AVX-512 F. The second operand is returned where either is NaN.
        unsafe { _mm512_max_ps(_mm512_setzero_ps(), value) }
    }
    #[inline(always)]
    fn gate(self, value: Self::V, gate: Self::V) -> Self::V {
        // SAFETY: self proves AVX-512 F. An ordered comparison with NaN is false.
        unsafe {
            let open = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(gate, _mm512_setzero_ps());
            _mm512_maskz_mov_ps(open, value)
        }
    }
}

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

/// Rows of F numbers, read at indices that are checked 128 at a time.
#[derive(Clone, Copy)]
pub struct Table<'a, const F: usize>(pub &'a [[f32; F]]);

/// As [`Table`], to be added to.
pub struct TableMut<'a, const F: usize>(pub &'a mut [[f32; F]]);

/// Indices of the 8 corners around 16 points, and the greatest of them.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub struct Indices {
    lanes: [[u32; LANES]; 8],
    most: u32,
}

impl Indices {
    /// All zero.
    pub const ZERO: Self = Self {
        lanes: [[0; LANES]; 8],
        most: 0,
    };

    /// Takes 8 vectors of indices over.
    #[inline(always)]
    pub fn fill<I: Isa>(&mut self, isa: I, corners: [I::U; 8]) {
        let mut most = corners[0];
        for corner in 0..8 {
            isa.store_u(corners[corner], &mut self.lanes[corner]);
            most = isa.max_u(most, corners[corner]);
        }
        let mut lanes = [0; LANES];
        isa.store_u(most, &mut lanes);
        self.most = 0;
        for lane in lanes {
            self.most = self.most.max(lane);
        }
    }
}

/// A table and indices that are all in it.
pub struct Checked<'a, const F: usize>(&'a [[f32; F]], &'a [[u32; LANES]; 8]);

/// As [`Checked`], to be added to.
pub struct CheckedMut<'a, const F: usize>(&'a mut [[f32; F]], &'a [[u32; LANES]; 8]);

impl<const F: usize> Table<'_, F> {
    /// Asks for the rows to be brought to the first cache.
    #[inline(always)]
    pub fn prefetch(&self, indices: &Indices) {
        for index in indices.lanes.as_flattened() {
            prefetch::<F, 0>(self.0, *index);
        }
    }

    /// Returns `None` if an index lies outside.
    #[inline(always)]
    pub fn check<'b>(&'b self, indices: &'b Indices) -> Option<Checked<'b, F>> {
        ((indices.most as usize) < self.0.len()).then_some(Checked(self.0, &indices.lanes))
    }
}

impl<const F: usize> TableMut<'_, F> {
    /// Asks for the rows to be brought to the first cache, to be written.
    #[inline(always)]
    pub fn prefetch(&self, indices: &Indices) {
        for index in indices.lanes.as_flattened() {
            prefetch::<F, 1>(self.0, *index);
        }
    }

    /// Returns `None` if an index lies outside.
    #[inline(always)]
    pub fn check<'b>(&'b mut self, indices: &'b Indices) -> Option<CheckedMut<'b, F>> {
        ((indices.most as usize) < self.0.len()).then_some(CheckedMut(self.0, &indices.lanes))
    }
}

impl<const F: usize> Checked<'_, F> {
    /// The row of one corner of one point.
    #[inline(always)]
    pub fn row(&self, corner: usize, lane: usize) -> &[f32; F] {
        // SAFETY: the greatest index was compared with the number of rows when self was made.
        unsafe { self.0.get_unchecked(self.1[corner][lane] as usize) }
    }
}

impl<const F: usize> CheckedMut<'_, F> {
    /// The row of one corner of one point.
    #[inline(always)]
    pub fn row(&mut self, corner: usize, lane: usize) -> &mut [f32; F] {
        // SAFETY: as in `Checked::row`; the borrow is exclusive.
        unsafe { self.0.get_unchecked_mut(self.1[corner][lane] as usize) }
    }
}

/// A hint without effect on any value, hence any index will do. `WRITE`: 1 where the row will be written.
#[inline(always)]
fn prefetch<const F: usize, const WRITE: i32>(table: &[[f32; F]], index: u32) {
    let row = table.as_ptr().wrapping_add(index as usize);
    #[cfg(target_arch = "x86_64")]
    // SAFETY: a prefetch reads nothing and cannot fault; SSE is part of x86-64.
    unsafe {
        if WRITE == 1 {
            _mm_prefetch::<_MM_HINT_ET0>(row.cast());
        } else {
            _mm_prefetch::<_MM_HINT_T0>(row.cast());
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = row;
}

/// A matrix in numbers: element (row, step) is at `row * self.row + step * self.step`.
#[derive(Clone, Copy)]
pub struct Strided<'a> {
    /// The numbers.
    pub numbers: &'a [f32],
    /// Distance of two rows.
    pub row: usize,
    /// Distance of two steps of the sum.
    pub step: usize,
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
    steps: usize,
) {
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

#[cfg(target_arch = "x86_64")]
impl Isa for Avx2 {
    type V = [__m256; 2];
    type U = [__m256i; 2];
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
    #[inline(always)]
    fn mul(self, a: Self::V, b: Self::V) -> Self::V {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_mul_ps(a[0], b[0]), _mm256_mul_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn sub(self, a: Self::V, b: Self::V) -> Self::V {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_sub_ps(a[0], b[0]), _mm256_sub_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn add_u(self, a: Self::U, b: Self::U) -> Self::U {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_add_epi32(a[0], b[0]), _mm256_add_epi32(a[1], b[1])] }
    }
    #[inline(always)]
    fn mul_u(self, a: Self::U, b: Self::U) -> Self::U {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_mullo_epi32(a[0], b[0]), _mm256_mullo_epi32(a[1], b[1])] }
    }
    #[inline(always)]
    fn xor_u(self, a: Self::U, b: Self::U) -> Self::U {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_xor_si256(a[0], b[0]), _mm256_xor_si256(a[1], b[1])] }
    }
    #[inline(always)]
    fn and_u(self, a: Self::U, b: Self::U) -> Self::U {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_and_si256(a[0], b[0]), _mm256_and_si256(a[1], b[1])] }
    }
    #[inline(always)]
    fn min_u(self, a: Self::U, b: Self::U) -> Self::U {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_min_epu32(a[0], b[0]), _mm256_min_epu32(a[1], b[1])] }
    }
    #[inline(always)]
    fn max_u(self, a: Self::U, b: Self::U) -> Self::U {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_max_epu32(a[0], b[0]), _mm256_max_epu32(a[1], b[1])] }
    }
    #[inline(always)]
    fn unit(self, value: Self::V) -> Self::V {
        // SAFETY: self proves AVX2. The second operand is returned where either is NaN.
        unsafe {
            let (zero, one) = (_mm256_setzero_ps(), _mm256_set1_ps(1.0));
            let above = [_mm256_max_ps(value[0], zero), _mm256_max_ps(value[1], zero)];
            [_mm256_min_ps(above[0], one), _mm256_min_ps(above[1], one)]
        }
    }
    #[inline(always)]
    fn whole(self, value: Self::V) -> Self::U {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_cvttps_epi32(value[0]), _mm256_cvttps_epi32(value[1])] }
    }
    #[inline(always)]
    fn float(self, value: Self::U) -> Self::V {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_cvtepi32_ps(value[0]), _mm256_cvtepi32_ps(value[1])] }
    }
    #[inline(always)]
    fn splat_u(self, value: u32) -> Self::U {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_set1_epi32(value.cast_signed()); 2] }
    }
    #[inline(always)]
    fn store_u(self, value: Self::U, to: &mut [u32; LANES]) {
        let at: *mut __m256i = to.as_mut_ptr().cast();
        // SAFETY: self proves AVX2; 16 u32 are 64 bytes; the borrow is exclusive.
        unsafe {
            _mm256_storeu_si256(at, value[0]);
            _mm256_storeu_si256(at.add(1), value[1]);
        }
    }
}

#[cfg(target_arch = "x86_64")]
impl Isa for Avx512 {
    type V = __m512;
    type U = __m512i;
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
    #[inline(always)]
    fn mul(self, a: Self::V, b: Self::V) -> Self::V {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_mul_ps(a, b) }
    }
    #[inline(always)]
    fn sub(self, a: Self::V, b: Self::V) -> Self::V {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_sub_ps(a, b) }
    }
    #[inline(always)]
    fn add_u(self, a: Self::U, b: Self::U) -> Self::U {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_add_epi32(a, b) }
    }
    #[inline(always)]
    fn mul_u(self, a: Self::U, b: Self::U) -> Self::U {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_mullo_epi32(a, b) }
    }
    #[inline(always)]
    fn xor_u(self, a: Self::U, b: Self::U) -> Self::U {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_xor_si512(a, b) }
    }
    #[inline(always)]
    fn and_u(self, a: Self::U, b: Self::U) -> Self::U {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_and_si512(a, b) }
    }
    #[inline(always)]
    fn min_u(self, a: Self::U, b: Self::U) -> Self::U {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_min_epu32(a, b) }
    }
    #[inline(always)]
    fn max_u(self, a: Self::U, b: Self::U) -> Self::U {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_max_epu32(a, b) }
    }
    #[inline(always)]
    fn unit(self, value: Self::V) -> Self::V {
        // SAFETY: self proves AVX-512 F. The second operand is returned where either is NaN.
        unsafe { _mm512_min_ps(_mm512_max_ps(value, _mm512_setzero_ps()), _mm512_set1_ps(1.0)) }
    }
    #[inline(always)]
    fn whole(self, value: Self::V) -> Self::U {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_cvttps_epi32(value) }
    }
    #[inline(always)]
    fn float(self, value: Self::U) -> Self::V {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_cvtepi32_ps(value) }
    }
    #[inline(always)]
    fn splat_u(self, value: u32) -> Self::U {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_set1_epi32(value.cast_signed()) }
    }
    #[inline(always)]
    fn store_u(self, value: Self::U, to: &mut [u32; LANES]) {
        // SAFETY: self proves AVX-512 F; 16 u32 are 64 bytes; the borrow is exclusive.
        unsafe { _mm512_storeu_si512(to.as_mut_ptr().cast(), value) }
    }
    #[inline(always)]
    fn pack(self, value: Self::V, lanes: u16) -> Self::V {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_maskz_compress_ps(lanes, value) }
    }
}

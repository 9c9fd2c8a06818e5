//! 8 and 16 lanes an instruction.

use std::arch::x86_64::*;

use marf_numeric::{Avx2, Avx512};

use super::isa::{Block, Isa, LANES};

/// Of every set of 8 lanes the lanes that are in it, from the lowest, then -1.
static PACKED: [[i8; 8]; 256] = {
    let mut packed = [[-1; 8]; 256];
    let mut lanes = 0;
    while lanes < 256 {
        let (mut lane, mut next) = (0, 0);
        while lane < 8 {
            if lanes >> lane & 1 == 1 {
                packed[lanes][next] = lane as i8;
                next += 1;
            }
            lane += 1;
        }
        lanes += 1;
    }
    packed
};

/// Returns the lanes whose bit is set at the front, in order, and 0 behind them.
#[inline(always)]
fn pack_8(_: Avx2, value: __m256, lanes: u8) -> __m256 {
    // SAFETY: the token proves AVX2. A row of the table is 8 bytes.
    unsafe {
        let from = _mm256_cvtepi8_epi32(_mm_loadl_epi64(PACKED[usize::from(lanes)].as_ptr().cast()));
        let packed = _mm256_permutevar8x32_ps(value, from);
        _mm256_andnot_ps(_mm256_castsi256_ps(_mm256_srai_epi32::<31>(from)), packed)
    }
}

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
        // SAFETY: self proves AVX2. A block is 16 f32, aligned to 64 bytes.
        unsafe { [_mm256_load_ps(at), _mm256_load_ps(at.add(8))] }
    }
    #[inline(always)]
    fn store(self, value: Self::V, to: &mut Block) {
        let at = to.0.as_mut_ptr();
        // SAFETY: as in `load`. The borrow is exclusive.
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
    fn bits(self, value: Self::V) -> Self::U {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_castps_si256(value[0]), _mm256_castps_si256(value[1])] }
    }
    #[inline(always)]
    fn splat_u(self, value: u32) -> Self::U {
        // SAFETY: self proves AVX2.
        unsafe { [_mm256_set1_epi32(value.cast_signed()); 2] }
    }
    #[inline(always)]
    fn store_u(self, value: Self::U, to: &mut [u32; LANES]) {
        let at: *mut __m256i = to.as_mut_ptr().cast();
        // SAFETY: self proves AVX2. 16 u32 are 64 bytes. The borrow is exclusive.
        unsafe {
            _mm256_storeu_si256(at, value[0]);
            _mm256_storeu_si256(at.add(1), value[1]);
        }
    }
    #[inline(always)]
    fn pack(self, value: Self::V, lanes: u16, to: &mut [f32; LANES]) {
        let [low, high] = lanes.to_le_bytes();
        let at = to.as_mut_ptr();
        // SAFETY: self proves AVX2. The low half has at most 8, so that 8 numbers behind them are in bounds.
        unsafe {
            _mm256_storeu_ps(at.add(8), _mm256_setzero_ps());
            _mm256_storeu_ps(at, pack_8(self, value[0], low));
            _mm256_storeu_ps(at.add(low.count_ones() as usize), pack_8(self, value[1], high));
        }
    }
}

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
        // SAFETY: self proves AVX-512 F. A block is 16 f32, aligned to 64 bytes.
        unsafe { _mm512_load_ps(from.0.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, value: Self::V, to: &mut Block) {
        // SAFETY: as in `load`. The borrow is exclusive.
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
    fn bits(self, value: Self::V) -> Self::U {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_castps_si512(value) }
    }
    #[inline(always)]
    fn splat_u(self, value: u32) -> Self::U {
        // SAFETY: self proves AVX-512 F.
        unsafe { _mm512_set1_epi32(value.cast_signed()) }
    }
    #[inline(always)]
    fn store_u(self, value: Self::U, to: &mut [u32; LANES]) {
        // SAFETY: self proves AVX-512 F. 16 u32 are 64 bytes. The borrow is exclusive.
        unsafe { _mm512_storeu_si512(to.as_mut_ptr().cast(), value) }
    }
    #[inline(always)]
    fn pack(self, value: Self::V, lanes: u16, to: &mut [f32; LANES]) {
        // SAFETY: self proves AVX-512 F. `to` is 16 f32. The borrow is exclusive.
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), _mm512_maskz_compress_ps(lanes, value)) }
    }
}

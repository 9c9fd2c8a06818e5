//! Tables whose rows are read without a check a row.

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;

use super::isa::{Isa, LANES};

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

    /// Returns `None` if an index is out of bounds.
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

    /// Returns `None` if an index is out of bounds.
    #[inline(always)]
    pub fn check<'b>(&'b mut self, indices: &'b Indices) -> Option<CheckedMut<'b, F>> {
        ((indices.most as usize) < self.0.len()).then_some(CheckedMut(self.0, &indices.lanes))
    }
}

impl<const F: usize> Checked<'_, F> {
    /// Returns the row of one corner of one point.
    #[inline(always)]
    pub fn row(&self, corner: usize, lane: usize) -> &[f32; F] {
        // SAFETY: the greatest index was compared with the number of rows when self was made.
        unsafe { self.0.get_unchecked(self.1[corner][lane] as usize) }
    }
}

impl<const F: usize> CheckedMut<'_, F> {
    /// Returns the row of one corner of one point.
    #[inline(always)]
    pub fn row(&mut self, corner: usize, lane: usize) -> &mut [f32; F] {
        // SAFETY: as in `Checked::row`. The borrow is exclusive.
        unsafe { self.0.get_unchecked_mut(self.1[corner][lane] as usize) }
    }
}

/// Asks for a row to be brought to the first cache: a hint without effect on any value, hence any index will do. `WRITE`: 1 where the row will be written.
#[inline(always)]
fn prefetch<const F: usize, const WRITE: i32>(table: &[[f32; F]], index: u32) {
    let row = table.as_ptr().wrapping_add(index as usize);
    #[cfg(target_arch = "x86_64")]
    // SAFETY: a prefetch reads nothing and cannot fault. SSE is part of x86-64.
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

/// Asks for all numbers to be brought to the second cache, in order: a hint without effect on any value.
pub fn prefetch_all(numbers: &[f32]) {
    #[cfg(target_arch = "x86_64")]
    for line in numbers.chunks(LANES) {
        // SAFETY: a prefetch reads nothing and cannot fault. SSE is part of x86-64.
        unsafe { _mm_prefetch::<_MM_HINT_T1>(line.as_ptr().cast()) }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = numbers;
}

//! Dot products of descriptors by hand-written instructions. The only file of this crate with `unsafe`.
//!
//! The instruction set is chosen by [`marf_numeric::InstructionSet`]. Every set gives the same bits: nothing is
//! computed with fused multiply-add, and the dot products are integers.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;

pub(crate) use marf_numeric::InstructionSet;
use marf_numeric::Plain;
#[cfg(target_arch = "x86_64")]
use marf_numeric::{Avx2, Avx512};

/// Descriptors in a block of rows.
pub(crate) const ROWS: usize = 8;
/// Descriptors in a block of columns.
pub(crate) const COLUMNS: usize = 16;
/// Groups of four bytes in a descriptor.
const QUADS: usize = 32;

/// Dot products of every row with every column of two blocks.
pub(crate) type Dots = [[i32; COLUMNS]; ROWS];

/// Eight descriptors, each group of four bytes in the forms that the instruction sets multiply.
pub(crate) struct RowBlock {
    bytes: [[[u8; 4]; QUADS]; ROWS],
    /// Every byte less 128, signed.
    signed: [[i32; QUADS]; ROWS],
    /// Bytes 0 and 2, then bytes 1 and 3, as pairs of 16 bits.
    even: [[i32; QUADS]; ROWS],
    odd: [[i32; QUADS]; ROWS],
}

/// Sixteen descriptors side by side: a group of four bytes of each, then the next group.
#[repr(C, align(64))]
pub(crate) struct ColumnBlock {
    quads: [[[u8; 4]; COLUMNS]; QUADS],
    /// 128 times the sum of each descriptor, which the signed rows lack.
    bias: [i32; COLUMNS],
}

impl RowBlock {
    /// Takes up to eight descriptors. Missing rows are zero.
    pub(crate) fn new(descriptors: &[[u8; 128]]) -> Self {
        let mut bytes = [[[0; 4]; QUADS]; ROWS];
        for (row, descriptor) in bytes.iter_mut().zip(descriptors) {
            row.copy_from_slice(descriptor.as_chunks().0);
        }
        let word = |row: usize, quad: usize| u32::from_le_bytes(bytes[row][quad]);
        let form = |of: fn(u32) -> u32| -> [[i32; QUADS]; ROWS] {
            std::array::from_fn(|row| std::array::from_fn(|quad| of(word(row, quad)) as i32))
        };
        Self {
            signed: form(|word| word ^ 0x8080_8080),
            even: form(|word| word & 0x00ff_00ff),
            odd: form(|word| (word >> 8) & 0x00ff_00ff),
            bytes,
        }
    }
}

impl ColumnBlock {
    /// Takes up to sixteen descriptors. Missing columns are zero.
    pub(crate) fn new(descriptors: &[[u8; 128]]) -> Self {
        let mut block = Self {
            quads: [[[0; 4]; COLUMNS]; QUADS],
            bias: [0; COLUMNS],
        };
        for (column, descriptor) in descriptors.iter().enumerate().take(COLUMNS) {
            for (quad, bytes) in descriptor.as_chunks::<4>().0.iter().enumerate() {
                block.quads[quad][column] = *bytes;
            }
            block.bias[column] = descriptor.iter().map(|&byte| 128 * i32::from(byte)).sum();
        }
        block
    }
}

/// The one operation that the compiler does not reliably vectorise.
pub(crate) trait Lanes: Copy {
    /// Returns the dot product of every row with every column, exactly.
    fn dots(self, rows: &RowBlock, columns: &ColumnBlock) -> Dots;
}

/// A computation that is compiled once for each instruction set.
///
/// `run` and all it calls should be `#[inline(always)]`, so that its loops over independent lanes are compiled with
/// the instructions of the set. Code that is not inlined is slower, never different.
pub(crate) trait Kernel {
    /// What the computation returns.
    type Output;
    /// Computes with the lanes of one instruction set.
    fn run<L: Lanes>(self, lanes: L) -> Self::Output;
}

/// Runs a kernel on an instruction set.
pub(crate) fn run<K: Kernel>(set: InstructionSet, kernel: K) -> K::Output {
    set.dispatch(Dispatched(kernel))
}

marf_numeric::dispatch_kernels!(Kernel, |kernel, token| kernel.run(token));

impl Lanes for Plain {
    #[inline(always)]
    fn dots(self, rows: &RowBlock, columns: &ColumnBlock) -> Dots {
        let mut dots = [[0; COLUMNS]; ROWS];
        for (quad, column_bytes) in columns.quads.iter().enumerate() {
            for (sums, row) in dots.iter_mut().zip(&rows.bytes) {
                for (sum, column) in sums.iter_mut().zip(column_bytes) {
                    let products = row[quad].iter().zip(column);
                    *sum += products.map(|(&a, &b)| i32::from(a) * i32::from(b)).sum::<i32>();
                }
            }
        }
        dots
    }
}

#[cfg(target_arch = "x86_64")]
impl Lanes for Avx2 {
    #[inline(always)]
    fn dots(self, rows: &RowBlock, columns: &ColumnBlock) -> Dots {
        let mut dots = [[0; COLUMNS]; ROWS];
        // Four rows at a time: 8 sums, 4 factors of the columns and 2 of the row fit the 16 registers.
        for (half, out) in dots.as_chunks_mut::<4>().0.iter_mut().enumerate() {
            // SAFETY: self proves AVX2. A group of 16 columns is 64 bytes, a row of sums 64 bytes.
            unsafe {
                let low = _mm256_set1_epi16(0xff);
                let mut sums = [[_mm256_setzero_si256(); 2]; 4];
                for quad in 0..QUADS {
                    let at = columns.quads[quad].as_ptr().cast::<__m256i>();
                    let bytes = [_mm256_load_si256(at), _mm256_load_si256(at.add(1))];
                    let even = bytes.map(|bytes| _mm256_and_si256(bytes, low));
                    let odd = bytes.map(|bytes| _mm256_srli_epi16::<8>(bytes));
                    for (row, sums) in sums.iter_mut().enumerate() {
                        let row_even = _mm256_set1_epi32(rows.even[half * 4 + row][quad]);
                        let row_odd = _mm256_set1_epi32(rows.odd[half * 4 + row][quad]);
                        for side in 0..2 {
                            let evens = _mm256_madd_epi16(even[side], row_even);
                            let odds = _mm256_madd_epi16(odd[side], row_odd);
                            sums[side] = _mm256_add_epi32(_mm256_add_epi32(sums[side], evens), odds);
                        }
                    }
                }
                for (out, sums) in out.iter_mut().zip(&sums) {
                    let at = out.as_mut_ptr().cast::<__m256i>();
                    _mm256_storeu_si256(at, sums[0]);
                    _mm256_storeu_si256(at.add(1), sums[1]);
                }
            }
        }
        dots
    }
}

#[cfg(target_arch = "x86_64")]
impl Lanes for Avx512 {
    #[inline(always)]
    fn dots(self, rows: &RowBlock, columns: &ColumnBlock) -> Dots {
        let mut dots = [[0; COLUMNS]; ROWS];
        // SAFETY: self proves AVX-512 F and VNNI. Groups, biases and rows of sums are 64 bytes each.
        unsafe {
            let mut sums = [_mm512_loadu_si512(columns.bias.as_ptr().cast()); ROWS];
            for quad in 0..QUADS {
                let bytes = _mm512_load_si512(columns.quads[quad].as_ptr().cast());
                for (sum, row) in sums.iter_mut().zip(&rows.signed) {
                    *sum = _mm512_dpbusd_epi32(*sum, bytes, _mm512_set1_epi32(row[quad]));
                }
            }
            for (out, &sum) in dots.iter_mut().zip(&sums) {
                _mm512_storeu_si512(out.as_mut_ptr().cast(), sum);
            }
        }
        dots
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_numeric::Rng;

    struct Once<'a>(&'a RowBlock, &'a ColumnBlock);

    impl Kernel for Once<'_> {
        type Output = Dots;
        #[inline(always)]
        fn run<L: Lanes>(self, lanes: L) -> Dots {
            lanes.dots(self.0, self.1)
        }
    }

    #[test]
    fn dot_products_are_exact_on_every_set_at_the_extremes() {
        let mut rng = Rng::new(3);
        let mut descriptor = |kind: usize| -> [u8; 128] {
            std::array::from_fn(|_| match kind {
                0 => 255,
                1 => 0,
                2 => 128,
                _ => rng.bits() as u8,
            })
        };
        let rows: Vec<[u8; 128]> = (0..ROWS).map(&mut descriptor).collect();
        let columns: Vec<[u8; 128]> = (0..COLUMNS).map(&mut descriptor).collect();
        let blocks = (RowBlock::new(&rows), ColumnBlock::new(&columns));
        for set in InstructionSet::all() {
            let dots = run(set, Once(&blocks.0, &blocks.1));
            for (row, dots) in rows.iter().zip(dots) {
                for (column, dot) in columns.iter().zip(dots) {
                    let products = row.iter().zip(column).map(|(&a, &b)| i32::from(a) * i32::from(b));
                    assert_eq!(dot, products.sum::<i32>(), "{set:?}");
                }
            }
        }
    }

    #[test]
    fn missing_descriptors_are_zero() {
        let one = [[1_u8; 128]];
        for set in InstructionSet::all() {
            let dots = run(set, Once(&RowBlock::new(&one), &ColumnBlock::new(&one)));
            assert_eq!(dots[0][0], 128, "{set:?}");
            assert!(
                dots[0][1..].iter().chain(&dots[1]).all(|&dot| dot == 0),
                "{set:?}"
            );
        }
    }
}

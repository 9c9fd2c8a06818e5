//! How similar two photos are by their descriptors.

use std::array;

use crate::descriptor::{CELLS, PixelSize};

/// Shifts along an axis: -1, 0 and 1 cells. 1 of 64 covers the shift that cropping and resampling make.
const SHIFTS: usize = 3;
/// Cells a side of a plane with a margin of zeros around it.
const PADDED: usize = CELLS + 2;
/// Largest relative difference between the aspect ratios of two photos of one view.
const ASPECT_TOLERANCE: f64 = 0.05;

/// Returns the smallest Hamming distance between the hashes of two photos, over pairs of bands, in bits.
///
/// A narrow-band copy has the hash of its own band, not of the brightness. A blue one is 4 to 16 bits from the
/// brightness and 0 to 2 from the blue band of its original.
pub(crate) fn hash_distance(a: &[u64], b: &[u64]) -> u32 {
    let pairs = a.iter().flat_map(|x| b.iter().map(move |y| (x ^ y).count_ones()));
    pairs.min().unwrap_or(u64::BITS)
}

/// Whether two photos of any size have the same aspect ratio.
pub(crate) fn same_aspect(a: PixelSize, b: PixelSize) -> bool {
    let (first, second) = (
        f64::from(a.width) * f64::from(b.height),
        f64::from(b.width) * f64::from(a.height),
    );
    (first - second).abs() <= ASPECT_TOLERANCE * first.max(second)
}

/// Returns the class of an aspect ratio. It differs by at most 1 from that of every ratio that [`same_aspect`]
/// accepts: those differ by 0.0513 in their logarithm, and classes are 0.08 wide.
pub(crate) fn aspect_class(size: PixelSize) -> u8 {
    let ratio = f64::from(size.width.max(1)) / f64::from(size.height.max(1));
    // Sides have at most 32 bits: from -277.3 to 277.3. Sides of up to 20,000 pixels keep to 4 to 252.
    (ratio.ln() / 0.08 + 128.0).clamp(0.0, 255.0) as u8
}

/// The gradient images of a photo, with the sums that correlations need.
pub(crate) struct Planes(Vec<Plane>);

/// One band.
struct Plane {
    /// `[PADDED * PADDED]` values in [0, 255], row-major, zero at the margin.
    cells: Vec<i16>,
    /// Sum of the values, variance times the squared count, and its root, of each part that remains after a shift:
    /// all but the first, no, or all but the last column and row.
    parts: [[Part; SHIFTS]; SHIFTS],
}

/// Sums over a part of a plane.
#[derive(Clone, Copy, Default)]
struct Part {
    sum: i64,
    spread: i64,
    root: f64,
}

impl Planes {
    /// Reads planes of `CELLS * CELLS` bytes. `None` if the bytes are empty or hold a partial plane.
    pub(crate) fn read(bytes: &[u8]) -> Option<Self> {
        let whole = !bytes.is_empty() && bytes.len().is_multiple_of(CELLS * CELLS);
        whole.then(|| Self(bytes.chunks_exact(CELLS * CELLS).map(Plane::new).collect()))
    }

    /// Returns the memory they take, in bytes.
    pub(crate) fn size_bytes(&self) -> usize {
        self.0.len() * (2 * PADDED * PADDED + size_of::<Plane>())
    }
}

/// Returns the columns (or rows) of the first image that overlap with those of the second one, when it is shifted by
/// `shift` - 1.
fn overlap(shift: usize) -> std::ops::Range<usize> {
    shift.saturating_sub(1)..CELLS - 1_usize.saturating_sub(shift)
}

/// Returns the sum and the sum of squares of a row, for each shift, where rows overlap.
fn row_sums(values: &[u8]) -> [[i64; 2]; SHIFTS] {
    let values = values.iter().map(|value| i64::from(*value));
    let whole = values.clone().fold([0, 0], |[sum, squares], value| {
        [sum + value, squares + value * value]
    });
    let without = |value: Option<i64>| {
        let value = value.unwrap_or(0);
        [whole[0] - value, whole[1] - value * value]
    };
    [
        without(values.clone().next_back()),
        whole,
        without(values.clone().next()),
    ]
}

/// Returns the sum of the products of two rows.
fn dot(a: &[i16; CELLS], b: &[i16; CELLS]) -> i32 {
    let products = a.iter().zip(b).map(|(a, b)| i32::from(*a) * i32::from(*b));
    products.sum()
}

impl Plane {
    fn new(values: &[u8]) -> Self {
        let mut cells = vec![0; PADDED * PADDED];
        let rows = cells.chunks_exact_mut(PADDED).skip(1);
        for (row, values) in rows.zip(values.chunks_exact(CELLS)) {
            row[1..=CELLS]
                .iter_mut()
                .zip(values)
                .for_each(|(cell, value)| *cell = i16::from(*value));
        }
        let mut sums = [[[0_i64; 2]; SHIFTS]; SHIFTS];
        for (row, values) in values.chunks_exact(CELLS).enumerate() {
            let of_row = row_sums(values);
            for (_, sums) in sums
                .iter_mut()
                .enumerate()
                .filter(|(down, _)| overlap(*down).contains(&row))
            {
                for (sums, of_row) in sums.as_flattened_mut().iter_mut().zip(of_row.as_flattened()) {
                    *sums += of_row;
                }
            }
        }
        let part = |right: usize, down: usize| {
            let [sum, squares] = sums[down][right];
            let spread = (overlap(right).len() * overlap(down).len()) as i64 * squares - sum * sum;
            Part {
                sum,
                spread,
                root: (spread as f64).sqrt(),
            }
        };
        Self {
            cells,
            parts: array::from_fn(|down| array::from_fn(|right| part(right, down))),
        }
    }

    /// Returns the 64 cells from (`left`, `top`) of the padded plane on.
    fn row(&self, left: usize, top: usize) -> Option<&[i16; CELLS]> {
        self.cells[PADDED * top + left..].first_chunk()
    }

    /// Returns the sum of the products with another plane, shifted by (`right`, `down`) - 1 cells, where they
    /// overlap. The margin adds zeros.
    fn products(&self, other: &Self, right: usize, down: usize) -> i64 {
        let rows =
            (0..CELLS).filter_map(|row| self.row(1, row + 1).zip(other.row(2 - right, row + 2 - down)));
        // 64 products of at most 255^2 a row, 64 rows: below 2^29.
        i64::from(rows.map(|(a, b)| dot(a, b)).sum::<i32>())
    }

    /// Returns the correlation of the plane, shifted by (`right`, `down`) - 1 cells, with another, where they overlap: in exact
    /// integers up to the last division.
    ///
    /// Extremes: 1 for two flat images, 0 for a flat and another one.
    fn shifted_correlation(&self, other: &Self, right: usize, down: usize) -> f64 {
        let (a, b) = (self.parts[down][right], other.parts[2 - down][2 - right]);
        match (a.spread, b.spread) {
            (0, 0) => 1.0,
            (0, _) | (_, 0) => 0.0,
            _ => {
                let count = (overlap(right).len() * overlap(down).len()) as i64;
                let joint = count * self.products(other, right, down) - a.sum * b.sum;
                joint as f64 / (a.root * b.root)
            }
        }
    }

    /// Returns the largest correlation over all shifts.
    fn best_shift(&self, other: &Self) -> f64 {
        let mut best = -1.0_f64;
        for down in 0..SHIFTS {
            for right in 0..SHIFTS {
                best = best.max(self.shifted_correlation(other, right, down));
            }
        }
        best
    }
}

/// Returns the largest normalised correlation of gradient images over pairs of bands and small shifts, in [-1, 1].
///
/// Taking the best pair of bands raises two different views by 0.01 at most, and a blue copy from 0.90 to 0.999 (rover
/// set).
pub(crate) fn correlation(a: &Planes, b: &Planes) -> f64 {
    let pairs = a.0.iter().flat_map(|x| b.0.iter().map(move |y| (x, y)));
    pairs.map(|(x, y)| x.best_shift(y)).fold(-1.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(value: impl Fn(usize, usize) -> usize) -> Vec<u8> {
        (0..CELLS * CELLS)
            .map(|at| value(at % CELLS, at / CELLS) as u8)
            .collect()
    }

    fn best_shift(a: &[u8], b: &[u8]) -> f64 {
        Plane::new(a).best_shift(&Plane::new(b))
    }

    #[test]
    fn a_plane_correlates_with_itself_and_against_its_negative() {
        let a = plane(|x, y| (7 * x + 13 * y * y) % 250);
        let negative: Vec<u8> = a.iter().map(|value| 255 - value).collect();
        let unshifted = |b: &[u8]| Plane::new(&a).shifted_correlation(&Plane::new(b), 1, 1);
        assert_eq!((unshifted(&a), unshifted(&negative)), (1.0, -1.0));
    }

    /// By hand: a = 0 0 1 1 and b = 0 1 0 1 repeated have no correlation, a and 0 0 0 1 have 1 / sqrt 3.
    #[test]
    fn small_correlations_are_as_worked_by_hand() {
        let repeated = |values: [usize; 4]| Plane::new(&plane(|x, _| values[x % 4]));
        let with = |b| repeated([0, 0, 1, 1]).shifted_correlation(&repeated(b), 1, 1);
        assert_eq!(with([0, 1, 0, 1]), 0.0);
        assert!((with([0, 0, 0, 1]) - 1.0 / 3.0_f64.sqrt()).abs() < 1e-15);
    }

    /// The sums with a margin of zeros are those of the overlap, value by value.
    #[test]
    fn a_shifted_correlation_is_that_of_the_overlap() {
        let a = plane(|x, y| (x * x * 31 + y * 17 + x * y) % 256);
        let b = plane(|x, y| (x * 13 + y * y * 7 + 5 * x * y) % 256);
        for (right, down) in (0..9).map(|at| (at % 3, at / 3)) {
            let (mut sums, mut count) = ([0_i64; 5], 0);
            for (y, x) in (0..64_i64).flat_map(|y| (0..64_i64).map(move |x| (y, x))) {
                let (from_x, from_y) = (x + 1 - right as i64, y + 1 - down as i64);
                if (0..64).contains(&from_x) && (0..64).contains(&from_y) {
                    let at = |values: &[u8], x: i64, y: i64| i64::from(values[(64 * y + x) as usize]);
                    let (a, b) = (at(&a, x, y), at(&b, from_x, from_y));
                    [a, b, a * b, a * a, b * b]
                        .into_iter()
                        .zip(&mut sums)
                        .for_each(|(add, sum)| *sum += add);
                    count += 1;
                }
            }
            let [sum_a, sum_b, ab, aa, bb] = sums;
            let spreads = (count * aa - sum_a * sum_a, count * bb - sum_b * sum_b);
            let expected =
                (count * ab - sum_a * sum_b) as f64 / ((spreads.0 as f64).sqrt() * (spreads.1 as f64).sqrt());
            let found = Plane::new(&a).shifted_correlation(&Plane::new(&b), right, down);
            assert_eq!(found, expected, "({right}, {down})");
        }
    }

    #[test]
    fn a_shift_of_one_cell_is_found_and_one_of_three_is_not() {
        let value = |x: usize, y: usize| (x * 7919 + y * 104_729 + x * x * y * 31) % 251;
        let a = plane(value);
        for (shift, least, most) in [(1, 0.999, 1.0), (3, -1.0, 0.5)] {
            let found = best_shift(&a, &plane(|x, y| value(x + shift, y)));
            assert!((least..=most).contains(&found), "shift {shift}: {found}");
        }
    }

    #[test]
    fn flat_planes_are_alike_and_unlike_all_others() {
        let (flat, other) = (plane(|_, _| 3), plane(|x, _| x));
        assert_eq!(best_shift(&flat, &flat), 1.0);
        assert_eq!(best_shift(&flat, &other), 0.0);
    }

    #[test]
    fn planes_that_are_not_whole_are_refused() {
        for bytes in [0, 1, 4095, 4097] {
            assert!(Planes::read(&vec![0; bytes]).is_none(), "{bytes}");
        }
        assert!(Planes::read(&[0; 3 * 4096]).is_some());
    }

    #[test]
    fn equal_aspects_are_in_the_same_class_or_the_next() {
        let size = |width, height| PixelSize { width, height };
        for height in (1..20_000).step_by(97) {
            for width in [1, 2, 19, 20, 21, 640, 1999, 19_999, 20_000] {
                for percent in [95.0, 97.5, 100.0, 104.9, 105.3] {
                    let (a, b) = (
                        size(width, height),
                        size((f64::from(width) * percent / 100.0) as u32 + 1, height),
                    );
                    if same_aspect(a, b) {
                        assert!(aspect_class(a).abs_diff(aspect_class(b)) <= 1, "{a:?} {b:?}");
                    }
                }
            }
        }
    }
}

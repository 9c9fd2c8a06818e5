//! How similar two photos are by their descriptors.

use crate::descriptor::{CELLS, ViewDescriptor};

/// Largest shift in cells between two descriptors: 1 of 64 covers the shift that cropping and resampling make.
const MAX_SHIFT: usize = 1;
/// Largest relative difference between the aspect ratios of two photos of one view.
const ASPECT_TOLERANCE: f64 = 0.05;

/// Returns the smallest Hamming distance between the hashes of two descriptors, over pairs of bands, in bits.
///
/// A narrow-band copy has the hash of its own band, not of the brightness: a blue one lies 4 to 16 bits from
/// the brightness and 0 to 2 from the blue band of its original.
pub(crate) fn hash_distance(a: &ViewDescriptor, b: &ViewDescriptor) -> u32 {
    let pairs = a
        .hashes
        .iter()
        .flat_map(|x| b.hashes.iter().map(move |y| x.dist(y)));
    pairs.min().unwrap_or(u64::BITS)
}

/// Returns the Hamming distance between the hashes of brightness, in bits.
pub(crate) fn brightness_hash_distance(a: &ViewDescriptor, b: &ViewDescriptor) -> u32 {
    match (a.hashes.first(), b.hashes.first()) {
        (Some(a), Some(b)) => a.dist(b),
        _ => u64::BITS,
    }
}

/// Returns whether two photos have the same aspect ratio, whatever their size.
pub(crate) fn same_aspect(a: &ViewDescriptor, b: &ViewDescriptor) -> bool {
    let (first, second) = (
        f64::from(a.width) * f64::from(b.height),
        f64::from(b.width) * f64::from(a.height),
    );
    (first - second).abs() <= ASPECT_TOLERANCE * first.max(second)
}

/// Returns the largest normalised correlation of gradient images over pairs of bands and small shifts, in [-1, 1].
///
/// Taking the best pair of bands raises two different views by 0.01 at most, and a blue copy from 0.90 to 0.999 (rover
/// set).
pub(crate) fn correlation(a: &ViewDescriptor, b: &ViewDescriptor) -> f64 {
    let pairs = a
        .gradients
        .iter()
        .flat_map(|x| b.gradients.iter().map(move |y| (x, y)));
    pairs.map(|(x, y)| best_shift(x, y)).fold(-1.0, f64::max)
}

/// Returns the largest correlation of two bands over all shifts up to [`MAX_SHIFT`] cells.
fn best_shift(a: &[u8], b: &[u8]) -> f64 {
    let mut best = -1.0_f64;
    for down in 0..=2 * MAX_SHIFT {
        for right in 0..=2 * MAX_SHIFT {
            best = best.max(shifted_correlation(a, b, right, down));
        }
    }
    best
}

/// Returns the correlation of `a`, shifted by (right, down) - MAX_SHIFT cells, with `b`, where they overlap.
fn shifted_correlation(a: &[u8], b: &[u8], right: usize, down: usize) -> f64 {
    let columns = CELLS - MAX_SHIFT.abs_diff(right);
    let (a_left, b_left) = (right.saturating_sub(MAX_SHIFT), MAX_SHIFT.saturating_sub(right));
    let (a_top, b_top) = (down.saturating_sub(MAX_SHIFT), MAX_SHIFT.saturating_sub(down));
    let mut sums = Sums::default();
    for row in 0..CELLS - MAX_SHIFT.abs_diff(down) {
        let from = |top: usize, left: usize| (row + top) * CELLS + left;
        let (a_from, b_from) = (from(a_top, a_left), from(b_top, b_left));
        sums.add(&a[a_from..a_from + columns], &b[b_from..b_from + columns]);
    }
    sums.correlation()
}

/// Sums over pairs of values from which their correlation follows.
#[derive(Default)]
struct Sums {
    count: i64,
    a: i64,
    b: i64,
    ab: i64,
    aa: i64,
    bb: i64,
}

impl Sums {
    /// Adds the pairs of two rows.
    fn add(&mut self, a: &[u8], b: &[u8]) {
        let mut row = [0_u32; 5];
        for (a, b) in a.iter().zip(b) {
            let (a, b) = (u32::from(*a), u32::from(*b));
            row[0] += a;
            row[1] += b;
            row[2] += a * b;
            row[3] += a * a;
            row[4] += b * b;
        }
        let [a_sum, b_sum, ab, aa, bb] = row.map(i64::from);
        self.count += a.len() as i64;
        self.a += a_sum;
        self.b += b_sum;
        self.ab += ab;
        self.aa += aa;
        self.bb += bb;
    }

    /// Returns the normalised correlation, in exact integers up to the last division.
    ///
    /// Extremes: 1 for two flat images, 0 for a flat and another one.
    fn correlation(&self) -> f64 {
        let joint = self.count * self.ab - self.a * self.b;
        let (a, b) = (
            self.count * self.aa - self.a * self.a,
            self.count * self.bb - self.b * self.b,
        );
        match (a, b) {
            (0, 0) => 1.0,
            (0, _) | (_, 0) => 0.0,
            _ => joint as f64 / ((a as f64).sqrt() * (b as f64).sqrt()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(value: impl Fn(usize, usize) -> usize) -> Vec<u8> {
        (0..CELLS * CELLS)
            .map(|at| value(at % CELLS, at / CELLS) as u8)
            .collect()
    }

    #[test]
    fn a_plane_correlates_with_itself_and_against_its_negative() {
        let a = plane(|x, y| (7 * x + 13 * y * y) % 250);
        let negative: Vec<u8> = a.iter().map(|value| 255 - value).collect();
        assert_eq!(shifted_correlation(&a, &a, MAX_SHIFT, MAX_SHIFT), 1.0);
        assert_eq!(shifted_correlation(&a, &negative, MAX_SHIFT, MAX_SHIFT), -1.0);
    }

    /// By hand: a = 0 0 1 1 and b = 0 1 0 1 repeated have no correlation, a and 0 0 0 1 have 1 / sqrt 3.
    #[test]
    fn small_correlations_are_as_worked_by_hand() {
        let sums = |b: [u8; 4]| {
            let mut sums = Sums::default();
            sums.add(&[0, 0, 1, 1], &b);
            sums.correlation()
        };
        assert_eq!(sums([0, 1, 0, 1]), 0.0);
        assert!((sums([0, 0, 0, 1]) - 1.0 / 3.0_f64.sqrt()).abs() < 1e-15);
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
}

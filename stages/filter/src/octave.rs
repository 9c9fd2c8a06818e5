//! How much a picture loses when it is blurred once more.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::luma::{Luma, Plane};

/// Rows of one band.
const BAND: usize = 32;
/// Pixels from which sharpness is measured at least. A larger picture is measured in bands from top to bottom.
const MIN_PIXELS: usize = 1 << 18;
/// Fewest bands, so that sky, horizon and ground all count.
const MIN_BANDS: usize = 8;
/// Rows above and below that the blur of a row needs.
const REACH: usize = 4;

/// Sums of squared second differences of a picture before and after one more blur, in squared steps of 1/256.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Octave {
    /// Number of pixels measured.
    pixels: u64,
    /// Sums before the blur, along rows and along columns.
    before: [u64; 2],
    /// Sums after the blur, along rows and along columns.
    after: [u64; 2],
}

impl Octave {
    /// Measures a picture at full size.
    pub(crate) fn from_luma(luma: &Luma) -> Self {
        Self::new(luma.width, luma.height, |pixels| {
            luma.values[pixels]
                .iter()
                .map(|value| u16::from(*value) << 8)
                .collect()
        })
    }

    /// Measures a picture at reduced size.
    pub(crate) fn from_plane(plane: &Plane) -> Self {
        Self::new(plane.width, plane.height, |pixels| plane.values[pixels].to_vec())
    }

    /// Measures bands of a picture. `values` returns a range of its `[height * width]` values.
    fn new(width: usize, height: usize, values: impl Fn(Range<usize>) -> Vec<u16>) -> Self {
        let mut octave = Self::default();
        for (top, bottom) in bands(width, height) {
            let first = top.saturating_sub(REACH + 1);
            let last = (bottom + REACH + 1).min(height);
            octave.add(&Band {
                width,
                height,
                first,
                rows: values(first * width..last * width),
                top,
                bottom,
            });
        }
        octave
    }

    /// Adds the sums of one band.
    fn add(&mut self, band: &Band) {
        self.pixels += ((band.bottom - band.top) * band.width) as u64;
        let first = band.top.saturating_sub(1);
        let last = (band.bottom + 1).min(band.height);
        let blurred = band.blurred(first, last);
        let sharp = &band.rows[(first - band.first) * band.width..(last - band.first) * band.width];
        let found = [
            second_differences(band.width, sharp),
            second_differences(band.width, &blurred),
        ];
        for (sums, found) in [&mut self.before, &mut self.after].into_iter().zip(found) {
            (0..2).for_each(|axis| sums[axis] = sums[axis].saturating_add(found[axis]));
        }
    }

    /// Returns the reblur ratio along rows (0) or columns (1): the sum before the blur over the sum after it. 1 for a
    /// flat picture.
    pub(crate) fn ratio(&self, axis: usize) -> f64 {
        // One step of 1/256 a pixel on both sides: below rounding, and flat photos get 1 instead of 0 / 0.
        (self.before[axis] + self.pixels) as f64 / (self.after[axis] + self.pixels) as f64
    }

    /// Returns the smaller ratio of both axes, and the axis.
    pub(crate) fn lowest(&self) -> (f64, usize) {
        let ratios = [self.ratio(0), self.ratio(1)];
        if ratios[1] < ratios[0] {
            (ratios[1], 1)
        } else {
            (ratios[0], 0)
        }
    }

    /// Returns the larger ratio of both axes.
    pub(crate) fn highest(&self) -> f64 {
        self.ratio(0).max(self.ratio(1))
    }
}

/// Returns the bands `[top, bottom)` to measure: the whole of a small picture, else bands at even distances from the top
/// row to the bottom row.
fn bands(width: usize, height: usize) -> Vec<(usize, usize)> {
    let count = (MIN_PIXELS / (BAND * width.max(1))).max(MIN_BANDS);
    if count * BAND * 2 >= height {
        return vec![(0, height)];
    }
    let place = |index: usize| index * (height - BAND) / (count - 1);
    (0..count)
        .map(|index| (place(index), place(index) + BAND))
        .collect()
}

/// Writes the means of nine slices, each at least as long as `out`, weighted by the binomial of order 8.
///
/// A function of its own, so that the compiler knows that `out` is none of the slices, and vectorises the loop.
#[inline(never)]
fn blur(taps: [&[u16]; 2 * REACH + 1], out: &mut [u16]) {
    let [a, b, c, d, e, f, g, h, i] = taps.map(|tap| &tap[..out.len()]);
    for (at, out) in out.iter_mut().enumerate() {
        let pair = |near: &[u16], far: &[u16]| u32::from(near[at]) + u32::from(far[at]);
        // The weights add up to 256.
        let sum = 70 * u32::from(e[at]) + 56 * pair(d, f) + 28 * pair(c, g) + 8 * pair(b, h) + pair(a, i);
        *out = ((sum + 128) >> 8) as u16;
    }
}

/// Returns the sum of the squared second differences of the first `count` values of three slices, element by element.
fn sum_of_squares(rows: [&[u16]; 3], count: usize) -> u64 {
    let [before, here, after] = rows.map(|row| &row[..count]);
    let squares = (0..count).map(|at| {
        let difference = i32::from(before[at]) + i32::from(after[at]) - 2 * i32::from(here[at]);
        let difference = u64::from(difference.unsigned_abs());
        difference * difference
    });
    squares.sum()
}

/// The rows of a band and those around it that its blur needs.
struct Band {
    width: usize,
    height: usize,
    /// Number of the first of `rows` in the picture.
    first: usize,
    /// `[height * width]` values in steps of 1/256.
    rows: Vec<u16>,
    top: usize,
    bottom: usize,
}

impl Band {
    /// Blurs rows `[from, to)` by the binomial of order 8 (1 8 28 56 70 56 28 8 1) along both axes. This is a
    /// Gaussian of sigma 1.41 in integers, the same on every machine. Edges of the picture repeat.
    fn blurred(&self, from: usize, to: usize) -> Vec<u16> {
        let mut along = vec![0; self.rows.len()];
        let mut padded = vec![0; self.width + 2 * REACH];
        let rows = self.rows.chunks_exact(self.width.max(1));
        for (row, along) in rows.zip(along.chunks_exact_mut(self.width.max(1))) {
            padded[..REACH].fill(row[0]);
            padded[REACH..REACH + self.width].copy_from_slice(row);
            padded[REACH + self.width..].fill(row[self.width - 1]);
            blur(std::array::from_fn(|tap| &padded[tap..]), along);
        }
        let mut blurred = vec![0; (to - from) * self.width];
        for (y, out) in (from..to).zip(blurred.chunks_exact_mut(self.width.max(1))) {
            let taps = std::array::from_fn(|tap| {
                let near = (y + tap).saturating_sub(REACH).min(self.height - 1) - self.first;
                &along[near * self.width..]
            });
            blur(taps, out);
        }
        blurred
    }
}

/// Returns the sums of squared second differences over all inner pixels, along rows and along columns. 0 if a side is
/// below 3.
///
/// At most 2^18 to 2^19 pixels of (4 * 65280)² fit in 56 bits. A picture of one very large band saturates.
fn second_differences(width: usize, rows: &[u16]) -> [u64; 2] {
    let mut sums = [0_u64; 2];
    let inner = width.saturating_sub(2);
    let rows: Vec<&[u16]> = rows.chunks_exact(width.max(1)).collect();
    for near in rows.windows(3) {
        let here = &near[1][..inner + width.min(2)];
        let across = sum_of_squares([here, &here[width.min(1)..], &here[width.min(2)..]], inner);
        let along = sum_of_squares([near[0], near[1], near[2]].map(|row| &row[width.min(1)..]), inner);
        sums[0] = sums[0].saturating_add(across);
        sums[1] = sums[1].saturating_add(along);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::Image;

    fn luma(width: u32, height: u32, value: impl Fn(u32, u32) -> u8) -> Luma {
        Luma::from_image(&Image::from_fn(width, height, |x, y| [value(x, y); 3]))
    }

    /// By hand: two inner rows of 100² + 100² in steps of 1/256. Nothing changes along columns.
    #[test]
    fn a_vertical_step_has_second_differences_along_rows_only() {
        let octave = Octave::from_luma(&luma(6, 4, |x, _| if x < 3 { 0 } else { 100 }));
        assert_eq!(octave.before, [2 * 2 * 10_000 * 65_536, 0]);
        assert_eq!(octave.pixels, 24);
    }

    #[test]
    fn a_blurred_point_is_the_product_of_two_binomials() {
        let point = luma(17, 17, |x, y| if (x, y) == (8, 8) { 255 } else { 0 });
        let band = Band {
            width: 17,
            height: 17,
            first: 0,
            rows: point.values.iter().map(|value| u16::from(*value) << 8).collect(),
            top: 0,
            bottom: 17,
        };
        let blurred = band.blurred(0, 17);
        for (x, y, weight) in [
            (8, 8, 70.0 * 70.0),
            (9, 8, 56.0 * 70.0),
            (4, 8, 70.0),
            (3, 8, 0.0),
        ] {
            let (right, found) = (255.0 * weight / 65_536.0, f64::from(blurred[y * 17 + x]) / 256.0);
            assert!((found - right).abs() < 0.005, "({x}, {y}): {found} for {right}");
        }
    }

    #[test]
    fn bands_reach_from_the_first_row_to_the_last_and_are_enough() {
        for (width, height) in [(1440, 1920), (5120, 3840), (20_000, 20_000), (1, 20_000)] {
            let bands = bands(width, height);
            assert_eq!(
                (bands[0].0, bands[bands.len() - 1].1),
                (0, height),
                "{width} x {height}"
            );
            let rows: usize = bands.iter().map(|(top, bottom)| bottom - top).sum();
            assert!(
                rows >= (MIN_BANDS * BAND).min(height) && 2 * rows <= 2 * height,
                "{width} x {height}: {rows}"
            );
            assert!(
                bands.windows(2).all(|pair| pair[0].1 <= pair[1].0),
                "{width} x {height} overlap"
            );
        }
        assert_eq!(bands(320, 240), [(0, 240)]);
        assert_eq!(bands(0, 0), [(0, 0)]);
    }

    /// The measures of 8 bits equal those of the same picture in steps of 1/256.
    #[test]
    fn both_depths_give_the_same_numbers() {
        for (width, height) in [(1, 1), (3, 3), (2, 40), (61, 47), (700, 600)] {
            let luma = luma(width, height, |x, y| {
                ((x * x / 3 + y * y * 7 + x * y * 31) % 256) as u8
            });
            let plane = Plane {
                width: luma.width,
                height: luma.height,
                values: luma.values.iter().map(|value| u16::from(*value) << 8).collect(),
            };
            assert_eq!(
                Octave::from_luma(&luma),
                Octave::from_plane(&plane),
                "{width} x {height}"
            );
        }
    }

    /// A band in the middle is blurred with the rows around it, not against its own edge.
    #[test]
    fn a_texture_has_the_same_ratio_in_bands_and_as_a_whole() {
        let value = |x: u32, y: u32| ((x * x / 3 + y * y / 5 + x * y / 7) % 251) as u8;
        let whole = Octave::from_luma(&luma(1024, 500, value));
        let banded = Octave::from_luma(&luma(1024, 1500, value));
        assert!(banded.pixels < 1024 * 1500 / 2, "{banded:?}");
        for axis in 0..2 {
            let (a, b) = (whole.ratio(axis), banded.ratio(axis));
            assert!((a / b - 1.0).abs() < 0.25, "axis {axis}: {a} for {b}");
        }
    }

    #[test]
    fn flat_and_tiny_pictures_lose_nothing() {
        for (width, height) in [(1, 1), (2, 2), (1, 9), (9, 2), (1, 4000), (64, 64)] {
            let octave = Octave::from_luma(&luma(width, height, |_, _| 77));
            assert_eq!(
                (octave.ratio(0), octave.ratio(1)),
                (1.0, 1.0),
                "{width} x {height}"
            );
        }
    }
}

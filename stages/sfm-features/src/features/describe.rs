//! The RootSIFT descriptor of a keypoint.

use super::extrema::Extremum;
use super::gradient::{Gradient, exp_neg};
use super::keypoint::Descriptor;

/// Cells along a side, directions in a cell.
const CELLS: usize = 4;
const DIRECTIONS: usize = 8;
/// Width of a cell in standard deviations of the keypoint.
const CELL: f32 = 3.0;
/// Half the side of the window in cells, plus the half cell by which samples outside it contribute.
const REACH: f32 = (CELLS as f32 + 1.0) / 2.0;
/// Widest row of samples: the square root of 2 times 5 cells of 3 standard deviations, which are 4.03 px at most.
const ROW: usize = 88;
/// Largest value of one bin relative to the length, before the second normalisation.
const CLAMP: f32 = 0.2;
/// Adding this to a small number leaves the number, rounded to an integer, in the lowest bits (1.5 · 2^23).
const ROUND: f32 = 12_582_912.0;

/// Directions of a cell, side by side.
type Bins = [f32; DIRECTIONS];
/// Cells in rows of 8: 1 to 4 are those of the window, 0 and 5 collect samples outside it.
type Cells = [Bins; 64];

/// Returns the descriptor of a keypoint whose orientation is `eighths` of a turn.
///
/// Magnitudes are shared by the two nearest cells along each axis and the two nearest directions, in a Gaussian
/// window of 2 cells. Bins are clamped at 0.2 of the length, L1-normalised, square-rooted, times 512 (255 at most).
#[inline(always)]
pub(super) fn describe(gradient: &Gradient, point: &Extremum, eighths: f32) -> Descriptor {
    let angle = f64::from(eighths) * std::f64::consts::FRAC_PI_4;
    let frame = Frame {
        cos: libm::cos(angle) as f32 / (CELL * point.sigma),
        sin: libm::sin(angle) as f32 / (CELL * point.sigma),
        eighths,
    };
    let mut cells = [[0.0; DIRECTIONS]; 64];
    let radius = REACH * std::f32::consts::SQRT_2 * CELL * point.sigma;
    let mut samples = Samples::default();
    for y in within(point.y - radius, point.y + radius, gradient.height) {
        let dy = y as f32 - point.y;
        let (first, last) = frame.row(dy);
        let columns = within(point.x + first, point.x + last, gradient.width);
        if columns.is_empty() {
            continue;
        }
        let at = y * gradient.width + columns.start;
        let count = columns.len().min(ROW);
        let magnitudes = &gradient.magnitude[at..][..count];
        let eighths = &gradient.eighths[at..][..count];
        samples.set_row(&frame, columns.start as f32 - point.x, dy, magnitudes, eighths);
        samples.scatter(count, &mut cells);
    }
    root_sift(&cells)
}

/// Returns the integers of a range that have a gradient.
#[inline(always)]
fn within(first: f32, last: f32, len: usize) -> std::ops::Range<usize> {
    let end = (last.floor().max(-1.0) + 1.0) as usize;
    (first.ceil().max(1.0) as usize)..end.min(len - 1)
}

/// Transforms offsets in pixels to the rotated cells of the window.
struct Frame {
    /// Cosine and sine of the orientation, divided by the width of a cell in px.
    cos: f32,
    sin: f32,
    eighths: f32,
}

impl Frame {
    /// Returns the first and the last offset along a row, px, inside the window.
    #[inline(always)]
    fn row(&self, dy: f32) -> (f32, f32) {
        let (a, b) = (side(self.cos, self.sin * dy), side(-self.sin, self.cos * dy));
        (a.0.max(b.0), a.1.min(b.1))
    }
}

/// Returns the interval of x in which |slope x + offset| is at most `REACH`.
#[inline(always)]
fn side(slope: f32, offset: f32) -> (f32, f32) {
    if slope.abs() < 1e-6 {
        let all = if offset.abs() <= REACH { 1e6 } else { -1e6 };
        return (-all, all);
    }
    let (a, b) = ((-REACH - offset) / slope, (REACH - offset) / slope);
    (a.min(b), a.max(b))
}

/// Samples of one row of the window.
struct Samples {
    cell: [u32; ROW],
    right: [f32; ROW],
    down: [f32; ROW],
    weight: [f32; ROW],
    eighths: [f32; ROW],
}

impl Default for Samples {
    fn default() -> Self {
        Self {
            cell: [0; ROW],
            right: [0.0; ROW],
            down: [0.0; ROW],
            weight: [0.0; ROW],
            eighths: [0.0; ROW],
        }
    }
}

impl Samples {
    /// Computes cell, position in the cell, weight and direction of a row of gradients.
    #[inline(always)]
    fn set_row(&mut self, frame: &Frame, first: f32, dy: f32, magnitudes: &[f32], eighths: &[f32]) {
        let count = magnitudes.len().min(ROW);
        for lane in 0..count {
            let dx = first + lane as f32;
            let u = frame.cos * dx + frame.sin * dy;
            let v = frame.cos * dy - frame.sin * dx;
            // Cell centres at -1.5 .. 1.5 are cells 1 to 4. Rounding less a half is the lower neighbour.
            let (across, down) = (u + REACH, v + REACH);
            let (column, row) = (across - 0.5 + ROUND, down - 0.5 + ROUND);
            self.cell[lane] = (row.to_bits() & 7) * 8 + (column.to_bits() & 7);
            self.right[lane] = across - (column - ROUND);
            self.down[lane] = down - (row - ROUND);
            self.weight[lane] = magnitudes[lane] * exp_neg((u * u + v * v) * 0.125);
            let turned = eighths[lane] - frame.eighths;
            self.eighths[lane] = if turned < 0.0 { turned + 8.0 } else { turned };
        }
    }

    /// Adds every sample to four cells and two directions.
    #[inline(always)]
    fn scatter(&self, count: usize, cells: &mut Cells) {
        for lane in 0..count {
            let mut bins = [0.0; DIRECTIONS];
            for (direction, bin) in bins.iter_mut().enumerate() {
                let off = (self.eighths[lane] - direction as f32).abs();
                let off = if off > 4.0 { 8.0 - off } else { off };
                *bin = if off < 1.0 { 1.0 - off } else { 0.0 };
            }
            let (right, down) = (self.right[lane], self.down[lane]);
            let (low, high) = (self.weight[lane] * (1.0 - down), self.weight[lane] * down);
            let shares = [
                low * (1.0 - right),
                low * right,
                high * (1.0 - right),
                high * right,
            ];
            for (share, by) in shares.into_iter().zip([0, 1, 8, 9]) {
                let cell = &mut cells[(self.cell[lane] as usize + by) % 64];
                for (sum, bin) in cell.iter_mut().zip(bins) {
                    *sum += share * bin;
                }
            }
        }
    }
}

/// Returns the 128 bins of the window clamped, normalised and square-rooted. All 0 if the bins are.
#[inline(always)]
fn root_sift(cells: &Cells) -> Descriptor {
    let mut bins = [[0.0; DIRECTIONS]; CELLS * CELLS];
    for (index, to) in bins.iter_mut().enumerate() {
        *to = cells[(index / CELLS + 1) * 8 + index % CELLS + 1];
    }
    let most = CLAMP * total(bins.map(|cell| cell.map(|bin| bin * bin))).sqrt();
    let held = bins.map(|cell| cell.map(|bin| if bin < most { bin } else { most }));
    let scale = 512.0 * 512.0 / total(held).max(f32::MIN_POSITIVE);
    let rooted = held.map(|cell| cell.map(|bin| ((bin * scale).sqrt() + 0.5) as u8));
    let mut descriptor = [0; 128];
    descriptor.copy_from_slice(rooted.as_flattened());
    descriptor
}

/// Sums the cells for each direction, then the directions: one order on every instruction set.
#[inline(always)]
fn total(cells: [Bins; CELLS * CELLS]) -> f32 {
    let mut sums = [0.0; DIRECTIONS];
    for cell in cells {
        sums.iter_mut().zip(cell).for_each(|(sum, bin)| *sum += bin);
    }
    sums.into_iter().fold(0.0, |sum, bin| sum + bin)
}

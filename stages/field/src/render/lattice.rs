//! The pixels of a strip that are always traced, and interpolation between those that are alike.

use crate::picture::Render;

/// Rows of a strip.
pub const STRIP: u32 = 8;
/// Columns of a tile, whose rays share their steps.
pub const TILE: u32 = 8;
/// Rows with knots: no row is between knots more than 3 rows apart, and a strip needs no rows of others.
const KNOT_ROWS: [u32; 4] = [0, 2, 5, 7];
/// Depths that differ by more than this share of their mean are of different surfaces.
const SAME_DEPTH: f32 = 0.1;

/// The pixels of a strip. Its knots are every second column and the last, in the rows of [`KNOT_ROWS`] and the last.
pub struct Lattice {
    width: u32,
    height: u32,
}

/// Two knots on an axis and a place between them.
#[derive(Clone, Copy)]
struct Between {
    low: u32,
    high: u32,
    /// Share of the way from low to high.
    share: f32,
}

impl Between {
    fn new(at: u32, low: u32, high: u32) -> Self {
        let share = (at - low) as f32 / (high - low).max(1) as f32;
        Self { low, high, share }
    }
}

impl Lattice {
    pub fn new(width: u32, height: u32) -> Self {
        Self { width, height }
    }

    /// Returns the numbers of the knots, tile by tile.
    pub fn knots(&self) -> Vec<u32> {
        self.pixels(|column, row| self.is_knot(column, row))
    }

    /// Returns the numbers of all other pixels, tile by tile.
    pub fn others(&self) -> Vec<u32> {
        self.pixels(|column, row| !self.is_knot(column, row))
    }

    fn pixels(&self, is_wanted: impl Fn(u32, u32) -> bool) -> Vec<u32> {
        let mut pixels = Vec::new();
        for left in (0..self.width).step_by(TILE as usize) {
            for row in 0..self.height {
                let columns = left..self.width.min(left + TILE);
                let wanted = columns.filter(|column| is_wanted(*column, row));
                pixels.extend(wanted.map(|column| row * self.width + column));
            }
        }
        pixels
    }

    fn is_knot(&self, column: u32, row: u32) -> bool {
        let in_row = KNOT_ROWS.contains(&row) || row + 1 == self.height;
        in_row && (column.is_multiple_of(2) || column + 1 == self.width)
    }

    fn across(&self, column: u32) -> Between {
        let high = column.next_multiple_of(2).min(self.width - 1);
        Between::new(column, column / 2 * 2, high)
    }

    fn down(&self, row: u32) -> Between {
        let last = self.height - 1;
        let low = KNOT_ROWS.iter().rfind(|knot| **knot <= row);
        let high = KNOT_ROWS.iter().find(|knot| **knot >= row);
        let [low, high] = [low, high].map(|knot| knot.map_or(last, |knot| last.min(*knot)));
        Between::new(row, low, high)
    }

    /// Interpolates a pixel where its knots differ by less than `alike`, and returns whether they do.
    pub fn interpolate(&self, strip: &mut Render, pixel: u32, alike: f32) -> bool {
        let across = self.across(pixel % self.width);
        let down = self.down(pixel / self.width);
        let knot = |row: u32, column: u32| (row * self.width + column) as usize;
        let knots = [
            knot(down.low, across.low),
            knot(down.low, across.high),
            knot(down.high, across.low),
            knot(down.high, across.high),
        ];
        let mean = |values: [f32; 4]| {
            let above = across.share.mul_add(values[1] - values[0], values[0]);
            let below = across.share.mul_add(values[3] - values[2], values[2]);
            down.share.mul_add(below - above, above)
        };
        let rgb = [0, 1, 2].map(|channel| knots.map(|knot| strip.rgb[knot][channel]));
        let opacity = knots.map(|knot| strip.opacity[knot]);
        let depth = knots.map(|knot| strip.depth[knot]);
        let is_alike = rgb.iter().chain([&opacity]).all(|values| range(values) < alike);
        if !is_alike || range(&depth) > SAME_DEPTH * mean(depth) {
            return false;
        }
        let pixel = pixel as usize;
        strip.rgb[pixel] = rgb.map(mean);
        strip.opacity[pixel] = mean(opacity);
        strip.depth[pixel] = mean(depth);
        true
    }
}

/// Returns the difference of the greatest and the least number.
fn range(values: &[f32; 4]) -> f32 {
    let [a, b, c, d] = *values;
    a.max(b).max(c.max(d)) - a.min(b).min(c.min(d))
}

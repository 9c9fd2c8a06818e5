use marf_scene::{Image, Srgb};

/// One channel of integers, rows from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Plane {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// `[height * width]`, row-major.
    pub(crate) values: Vec<u16>,
}

/// Sums of squared second differences, along rows and along columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Bends {
    pub(crate) along_rows: u64,
    pub(crate) along_columns: u64,
}

/// Returns the brightness of a pixel, (77 R + 150 G + 29 B) / 256 rounded, in [0, 255].
pub(crate) fn luma([red, green, blue]: [u8; 3]) -> u8 {
    ((77 * u32::from(red) + 150 * u32::from(green) + 29 * u32::from(blue) + 128) >> 8) as u8
}

impl Plane {
    /// Returns the brightness of an image in steps of 1/256, in [0, 65280].
    pub(crate) fn of(image: &Image<Srgb>) -> Self {
        Self {
            width: image.width as usize,
            height: image.height as usize,
            values: image
                .pixels
                .iter()
                .map(|pixel| u16::from(luma(*pixel)) << 8)
                .collect(),
        }
    }

    /// Returns the mean over blocks of 2 x 2, a last odd row or column cut. `None` once a side is below 2.
    pub(crate) fn halved(&self) -> Option<Self> {
        let (width, height) = (self.width / 2, self.height / 2);
        if width == 0 || height == 0 {
            return None;
        }
        let mut values = Vec::with_capacity(width * height);
        for rows in self.values.chunks_exact(2 * self.width).take(height) {
            let (upper, lower) = rows.split_at(self.width);
            let blocks = upper.chunks_exact(2).zip(lower.chunks_exact(2));
            values.extend(blocks.map(|(up, low)| {
                let sum = u32::from(up[0]) + u32::from(up[1]) + u32::from(low[0]) + u32::from(low[1]);
                ((sum + 2) >> 2) as u16
            }));
        }
        Some(Self {
            width,
            height,
            values,
        })
    }

    /// Blurs by the binomial of order 8 (1 8 28 56 70 56 28 8 1) along both axes: a Gauss of sigma 1.41 in
    /// integers, the same on every machine. Edges repeat.
    pub(crate) fn blurred(&self) -> Self {
        let mut values = Vec::with_capacity(self.values.len());
        let mut padded = vec![0; self.width + 8];
        for row in self.values.chunks_exact(self.width) {
            padded[..4].fill(row[0]);
            padded[4..4 + self.width].copy_from_slice(row);
            padded[4 + self.width..].fill(row[self.width - 1]);
            values.extend((0..self.width).map(|x| {
                let at = |offset: usize| u32::from(padded[x + offset]);
                binomial(at)
            }));
        }
        Self {
            values: self.blurred_down(&values),
            ..*self
        }
    }

    fn blurred_down(&self, values: &[u16]) -> Vec<u16> {
        let row = |y: usize| &values[y * self.width..(y + 1) * self.width];
        let mut out = Vec::with_capacity(values.len());
        for y in 0..self.height {
            let near: [&[u16]; 9] =
                std::array::from_fn(|k| row((y + k).saturating_sub(4).min(self.height - 1)));
            out.extend((0..self.width).map(|x| binomial(|offset| u32::from(near[offset][x]))));
        }
        out
    }

    /// Returns the sums over all inner pixels, in steps of 1/256 squared; 0 where a side is below 3.
    ///
    /// At most 2.5e7 pixels of (4 * 65280)² fit in 63 bits, ten times the largest photo that occurs; beyond it
    /// the sums saturate.
    pub(crate) fn bends(&self) -> Bends {
        let mut bends = Bends {
            along_rows: 0,
            along_columns: 0,
        };
        for y in 1..self.height.saturating_sub(1) {
            let row = |y: usize| &self.values[y * self.width..(y + 1) * self.width];
            let (up, here, down) = (row(y - 1), row(y), row(y + 1));
            let (mut across, mut along) = (0_u64, 0_u64);
            for x in 1..self.width.saturating_sub(1) {
                across += square(here[x - 1], here[x], here[x + 1]);
                along += square(up[x], here[x], down[x]);
            }
            bends.along_rows = bends.along_rows.saturating_add(across);
            bends.along_columns = bends.along_columns.saturating_add(along);
        }
        bends
    }

    /// Returns the variance of the 4-neighbour Laplacian over all inner pixels, in squared 8-bit steps; 0 where
    /// a side is below 3.
    pub(crate) fn laplacian_variance(&self) -> f64 {
        let (mut sum, mut squares, mut count) = (0_i64, 0_u64, 0_u64);
        for y in 1..self.height.saturating_sub(1) {
            for x in 1..self.width.saturating_sub(1) {
                let bend = self.laplacian(x, y);
                sum += bend;
                squares += bend.unsigned_abs() * bend.unsigned_abs();
                count += 1;
            }
        }
        let mean = sum as f64 / count.max(1) as f64;
        (squares as f64 / count.max(1) as f64 - mean * mean).max(0.0)
    }

    /// Returns the mean square of the Laplacian over pixels whose neighbours lie in the same 8 x 8 block: a copy
    /// of low JPEG quality has its sharpest steps between blocks. 0 where no block is whole.
    pub(crate) fn detail(&self) -> f64 {
        let inner = |side: usize| (0..side.saturating_sub(1)).filter(|at| (1..7).contains(&(at % 8)));
        let (mut squares, mut count) = (0_u64, 0_u64);
        for y in inner(self.height) {
            for x in inner(self.width) {
                squares += self.laplacian(x, y).pow(2).unsigned_abs();
                count += 1;
            }
        }
        squares as f64 / count.max(1) as f64
    }

    /// Returns the 4-neighbour Laplacian at an inner pixel, in 8-bit steps.
    fn laplacian(&self, x: usize, y: usize) -> i64 {
        let here = y * self.width + x;
        let step = |at: usize| i64::from(self.values[at] >> 8);
        step(here - self.width) + step(here + self.width) + step(here - 1) + step(here + 1) - 4 * step(here)
    }
}

fn binomial(at: impl Fn(usize) -> u32) -> u16 {
    let sum = 70 * at(4) + 56 * (at(3) + at(5)) + 28 * (at(2) + at(6)) + 8 * (at(1) + at(7)) + at(0) + at(8);
    ((sum + 128) >> 8) as u16
}

fn square(before: u16, here: u16, after: u16) -> u64 {
    let bend = i64::from(before) + i64::from(after) - 2 * i64::from(here);
    (bend * bend) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step() -> Plane {
        Plane::of(&Image::from_fn(
            6,
            4,
            |x, _| if x < 3 { [0; 3] } else { [100; 3] },
        ))
    }

    #[test]
    fn white_is_255_and_black_is_0() {
        assert_eq!((luma([255; 3]), luma([0; 3]), luma([128; 3])), (255, 0, 128));
    }

    /// By hand: inner columns 1 to 4 hold 0, 100, -100, 0 in each of two rows: mean 0, variance 20000 / 4.
    #[test]
    fn the_laplacian_of_a_step_of_100_has_variance_5000() {
        assert_eq!(step().laplacian_variance(), 5000.0);
    }

    /// By hand: two rows of 100² + 100² in steps of 1/256; nothing bends along columns.
    #[test]
    fn a_vertical_step_bends_along_rows_only() {
        let bends = step().bends();
        assert_eq!(bends.along_rows, 2 * 2 * 10_000 * 65_536);
        assert_eq!(bends.along_columns, 0);
    }

    #[test]
    fn a_blurred_point_is_the_product_of_two_binomials() {
        let image = Image::from_fn(17, 17, |x, y| if (x, y) == (8, 8) { [255; 3] } else { [0; 3] });
        let blurred = Plane::of(&image).blurred();
        let at = |x: usize, y: usize| f64::from(blurred.values[y * 17 + x]) / 256.0;
        for (x, y, weight) in [
            (8, 8, 70.0 * 70.0),
            (9, 8, 56.0 * 70.0),
            (4, 8, 70.0),
            (3, 8, 0.0),
        ] {
            let right = 255.0 * weight / 65_536.0;
            assert!(
                (at(x, y) - right).abs() < 0.005,
                "({x}, {y}): {} for {right}",
                at(x, y)
            );
        }
    }

    #[test]
    fn tiny_planes_have_no_bends() {
        for (width, height) in [(1, 1), (2, 2), (1, 9), (9, 2)] {
            let plane = Plane::of(&Image::from_fn(width, height, |x, y| [(40 * x + 9 * y) as u8; 3]));
            assert_eq!(plane.laplacian_variance(), 0.0, "{width} x {height}");
            assert_eq!(plane.blurred().values.len(), (width * height) as usize);
        }
    }
}

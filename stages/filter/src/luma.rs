//! The brightness of a photo, and its second differences.

use marf_scene::{Image, Srgb};

/// Brightness of a photo in 8-bit steps, rows from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Luma {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height * width]`, row-major.
    pub values: Vec<u8>,
}

/// Statistics of the Laplacian of the brightness at full size, in squared 8-bit steps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Laplacian {
    /// Variance of the 4-neighbour Laplacian over all inner pixels. 0 if a side is below 3.
    pub(crate) variance: f64,
    /// Mean square over pixels whose neighbours are in the same 8 x 8 block, because a copy of low JPEG quality has
    /// its sharpest steps between blocks. 0 if no block is whole.
    pub(crate) detail: f64,
}

/// Returns the brightness of a pixel, (77 R + 150 G + 29 B) / 256 rounded, in [0, 255].
pub(crate) fn luma([red, green, blue]: [u8; 3]) -> u8 {
    ((77 * u32::from(red) + 150 * u32::from(green) + 29 * u32::from(blue) + 128) >> 8) as u8
}

impl Luma {
    /// Returns the brightness of an image.
    pub(crate) fn from_image(image: &Image<Srgb>) -> Self {
        Self {
            width: image.width as usize,
            height: image.height as usize,
            values: image.pixels.iter().map(|pixel| luma(*pixel)).collect(),
        }
    }

    /// Returns row `y`.
    pub(crate) fn row(&self, y: usize) -> &[u8] {
        &self.values[y * self.width..(y + 1) * self.width]
    }

    /// Returns the statistics of the Laplacian, in one pass. Sums are exact integers.
    pub(crate) fn laplacian(&self) -> Laplacian {
        let inner = self.width.saturating_sub(2);
        // Whether the pixel and all its neighbours are in one block, by column.
        let whole: Vec<i32> = (1..=inner)
            .map(|x| i32::from((1..7).contains(&(x % 8))))
            .collect();
        let (mut sum, mut squares, mut detail) = (0_i64, 0_u64, 0_u64);
        let (mut count, mut blocks) = (0_u64, 0_u64);
        let mut differences = vec![0_i16; inner];
        let rows = if inner == 0 { 0 } else { self.height };
        for y in 1..rows.saturating_sub(1) {
            laplacian_row([y - 1, y, y + 1].map(|y| self.row(y)), &mut differences);
            let in_block = (1..7).contains(&(y % 8));
            // 512 squares of at most 1020² stay below 2^31.
            for (differences, whole) in differences.chunks(512).zip(whole.chunks(512)) {
                let squared = |difference: &i16| i32::from(*difference) * i32::from(*difference);
                sum += i64::from(
                    differences
                        .iter()
                        .map(|difference| i32::from(*difference))
                        .sum::<i32>(),
                );
                squares += differences.iter().map(squared).sum::<i32>() as u64;
                if in_block {
                    let pairs = differences.iter().zip(whole);
                    detail += pairs
                        .map(|(difference, whole)| squared(difference) * whole)
                        .sum::<i32>() as u64;
                }
            }
            count += inner as u64;
            if in_block {
                blocks += whole.iter().sum::<i32>() as u64;
            }
        }
        let mean = sum as f64 / count.max(1) as f64;
        Laplacian {
            variance: (squares as f64 / count.max(1) as f64 - mean * mean).max(0.0),
            detail: detail as f64 / blocks.max(1) as f64,
        }
    }

    /// Returns the picture at half size, means over 2 x 2 pixels. A last odd row or column is left out. `None` if a
    /// side is below 2.
    pub(crate) fn halved(&self) -> Option<Plane> {
        halved(self.width, self.height, |y| self.row(y), |sum| (sum << 6) as u16)
    }
}

/// Writes the 4-neighbour Laplacian of the inner pixels of a row.
fn laplacian_row([up, here, down]: [&[u8]; 3], differences: &mut [i16]) {
    let inner = differences.len();
    let level = here.iter().zip(&here[1..]).zip(&here[2..]);
    let upright = up[1..=inner].iter().zip(&down[1..=inner]);
    for ((difference, ((left, here), right)), (up, down)) in differences.iter_mut().zip(level).zip(upright) {
        let around = i16::from(*up) + i16::from(*down) + i16::from(*left) + i16::from(*right);
        *difference = around - 4 * i16::from(*here);
    }
}

/// Brightness in steps of 1/256, in [0, 65280], rows from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Plane {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// `[height * width]`, row-major.
    pub(crate) values: Vec<u16>,
}

impl Plane {
    /// Returns row `y`.
    pub(crate) fn row(&self, y: usize) -> &[u16] {
        &self.values[y * self.width..(y + 1) * self.width]
    }

    /// Returns the picture at half size, as [`Luma::halved`] does.
    pub(crate) fn halved(&self) -> Option<Self> {
        halved(
            self.width,
            self.height,
            |y| self.row(y),
            |sum| ((sum + 2) >> 2) as u16,
        )
    }
}

/// Returns a picture at half size. `mean` divides the sum of four values.
fn halved<'a, T: Copy + Into<u32> + 'a>(
    width: usize,
    height: usize,
    row: impl Fn(usize) -> &'a [T],
    mean: impl Fn(u32) -> u16,
) -> Option<Plane> {
    let (half_width, half_height) = (width / 2, height / 2);
    if half_width == 0 || half_height == 0 {
        return None;
    }
    let mut values = Vec::with_capacity(half_width * half_height);
    for y in 0..half_height {
        let (upper, lower) = (row(2 * y).as_chunks::<2>().0, row(2 * y + 1).as_chunks::<2>().0);
        values.extend(upper.iter().zip(lower).map(|(up, low)| {
            let sum: u32 = up[0].into() + up[1].into() + low[0].into() + low[1].into();
            mean(sum)
        }));
    }
    Some(Plane {
        width: half_width,
        height: half_height,
        values,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step() -> Luma {
        Luma::from_image(&Image::from_fn(
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
        assert_eq!(step().laplacian().variance, 5000.0);
    }

    /// By hand: all 36 inner pixels of an 8 x 8 image lie inside the block. One point of 10 has a Laplacian of -40
    /// and its four neighbours 10.
    #[test]
    fn detail_is_the_mean_over_the_inside_of_blocks() {
        let image = Image::from_fn(8, 8, |x, y| if (x, y) == (3, 3) { [10; 3] } else { [0; 3] });
        assert_eq!(Luma::from_image(&image).laplacian().detail, 2000.0 / 36.0);
    }

    #[test]
    fn edges_between_blocks_are_no_detail() {
        let blocks = Image::from_fn(64, 64, |x, y| [((x / 8 * 50 + y / 8 * 30) % 256) as u8; 3]);
        let found = Luma::from_image(&blocks).laplacian();
        assert_eq!(found.detail, 0.0);
        assert!(found.variance > 100.0, "{found:?}");
    }

    #[test]
    fn halves_are_means_whatever_the_depth() {
        let image = Image::from_fn(5, 4, |x, y| [(40 * x + y) as u8; 3]);
        let half = Luma::from_image(&image).halved().unwrap();
        assert_eq!((half.width, half.height), (2, 2));
        assert_eq!(
            half.values,
            [20.5, 100.5, 22.5, 102.5].map(|mean| (mean * 256.0) as u16)
        );
        assert_eq!(half.halved().unwrap().values, [(61.5 * 256.0) as u16]);
        assert_eq!(half.halved().unwrap().halved(), None);
    }

    #[test]
    fn tiny_planes_have_no_second_differences() {
        for (width, height) in [(1, 1), (2, 2), (1, 9), (9, 2)] {
            let luma = Luma::from_image(&Image::from_fn(width, height, |x, y| [(40 * x + 9 * y) as u8; 3]));
            let found = luma.laplacian();
            assert_eq!((found.variance, found.detail), (0.0, 0.0), "{width} x {height}");
        }
    }
}

//! How much detail photos have: the numbers of the bilinear patches that draw them.

use super::{Chosen, grouped};
use crate::View;
use crate::pixels::Pixels;

/// Sides of the largest and of the smallest patch, pixels; what a smallest one cannot draw takes a cell a pixel.
const LARGEST: usize = 32;
const SMALLEST: usize = 4;
/// A patch draws its pixels if each lies this near, gray levels: rounding to 8 bits takes half of one.
const TOLERANCE: f64 = 1.5;
/// Numbers of a bilinear patch: its corners.
const CORNERS: usize = 4;
/// Blocks of the largest side that are looked at, about: of all photos, the same share of each.
const BLOCKS: usize = 2048;

/// Returns the detail of fields that do not tell theirs: their tables had room for every pixel.
pub(super) fn detail_before() -> Chosen<f64> {
    Chosen::new(1.0, "not measured: all pixels count")
}

/// Returns how many numbers a pixel the photos take, in (0, 1]: 1 where every pixel differs from its neighbours, 1/256 of a plain slope.
///
/// Where no photo holds a whole block of 32 x 32 pixels, or all are thinned so that neighbours are gone, it is 1. Masked pixels count.
pub(super) fn detail(views: &[View]) -> Chosen<f64> {
    let photos = views.iter().map(|view| &view.image);
    let blocks: Vec<Block> = photos.flat_map(blocks).collect();
    if blocks.is_empty() {
        let reason = format!("no photo has {LARGEST} x {LARGEST} neighbouring pixels: all of them count");
        return Chosen::new(1.0, reason);
    }
    let seen = blocks.iter().step_by(blocks.len().div_ceil(BLOCKS));
    let count = seen.len();
    let numbers: usize = seen.map(Block::numbers).sum();
    let share = numbers as f64 / (count * LARGEST * LARGEST) as f64;
    let reason = format!(
        "{} corners of bilinear patches of {SMALLEST} to {LARGEST} pixels a side, and single pixels, draw {} blocks of {LARGEST} x {LARGEST} to within {TOLERANCE} gray levels",
        grouped(numbers as u64),
        grouped(count as u64)
    );
    Chosen::new(share, reason)
}

/// Returns the whole blocks of a photo whose pixels are all kept.
fn blocks(photo: &Pixels) -> impl Iterator<Item = Block<'_>> {
    let width = photo.width as usize;
    photo.all().into_iter().flat_map(move |pixels| {
        let corners = |length: usize| (0..length / LARGEST).map(|index| index * LARGEST);
        corners(pixels.len() / width).flat_map(move |row| {
            corners(width).map(move |column| Block {
                pixels: &pixels[row * width + column..],
                width,
                side: LARGEST,
            })
        })
    })
}

/// Square of a photo.
struct Block<'a> {
    /// Pixels of the photo from the first of the square on, `width` a row.
    pixels: &'a [[u8; 3]],
    width: usize,
    side: usize,
}

impl Block<'_> {
    /// Returns the numbers that draw it: the corners of a patch, or what its four quarters take.
    fn numbers(&self) -> usize {
        if self.side < SMALLEST {
            return self.side * self.side;
        }
        if (0..3).all(|channel| self.is_bilinear(channel)) {
            return CORNERS;
        }
        let half = self.side / 2;
        let corners = [0, half, half * self.width, half * self.width + half];
        let quarter = |corner: usize| Self {
            pixels: &self.pixels[corner..],
            side: half,
            ..*self
        };
        corners.into_iter().map(|corner| quarter(corner).numbers()).sum()
    }

    /// Returns whether the bilinear function nearest to a channel in the least squares is everywhere within the tolerance of it.
    fn is_bilinear(&self, channel: usize) -> bool {
        let last = self.side as i64 - 1;
        // Twice the distance from the middle: odd numbers, orthogonal to 1 and to each other's product.
        let at = |index: usize| 2 * index as i64 - last;
        let pixels = || {
            let rows = self.pixels.chunks(self.width).take(self.side).enumerate();
            rows.flat_map(move |(row, line)| {
                let line = line[..self.side].iter().enumerate();
                line.map(move |(column, pixel)| (at(column), at(row), i64::from(pixel[channel])))
            })
        };
        let mut sums = [0_i64; 4];
        for (x, y, value) in pixels() {
            let terms = [1, x, y, x * y];
            for (sum, term) in sums.iter_mut().zip(terms) {
                *sum += term * value;
            }
        }
        let count = self.side as i64;
        let squares: i64 = (0..self.side).map(|index| at(index).pow(2)).sum();
        let norms = [count * count, count * squares, count * squares, squares * squares];
        let [mean, by_x, by_y, by_xy] = [0, 1, 2, 3].map(|term| sums[term] as f64 / norms[term] as f64);
        pixels().all(|(x, y, value)| {
            let (x, y) = (x as f64, y as f64);
            let drawn = mean + by_x * x + by_y * y + by_xy * x * y;
            (value as f64 - drawn).abs() <= TOLERANCE
        })
    }
}

#[cfg(test)]
mod tests {
    use marf_scene::{Camera, Image, Pose};
    use proptest::prelude::*;

    use super::*;
    use crate::rng::{Purpose, Rng};

    /// A photo of `[height, width]` gray levels.
    fn photo(width: u32, height: u32, gray: impl Fn(u32, u32) -> u8) -> View {
        let image = Image::from_fn(width, height, |column, row| [gray(column, row); 3]);
        View {
            id: "photo".into(),
            camera: Camera::pinhole(width, height, 100.0),
            cam_from_world: Pose::identity(),
            image: image.into(),
        }
    }

    fn share(width: u32, height: u32, gray: impl Fn(u32, u32) -> u8) -> f64 {
        detail(&[photo(width, height, gray)]).value
    }

    #[test]
    fn slopes_take_a_patch_a_block_and_noise_a_cell_a_pixel() {
        let block = 4.0 / 1024.0;
        assert_eq!(share(64, 64, |_, _| 7), block);
        assert_eq!(share(64, 64, |column, row| (2 * column + row) as u8), block);
        assert_eq!(share(32, 32, |column, row| (column * row / 4) as u8), block);
        let noise = |column: u32, row: u32| {
            Rng::new(1, Purpose::Thinning, column.into(), row.into()).below(256) as u8
        };
        assert_eq!(share(64, 64, noise), 1.0);
    }

    #[test]
    fn an_edge_takes_small_patches_only_where_it_is() {
        // The edge lies in the third column of patches of 4: those 8 take 16 cells each. The 8 to their right, 4 of 8 pixels to their left, and
        // 2 of 16 on the other half hold none of it.
        let edge = |column: u32, _: u32| if column < 10 { 0 } else { 200 };
        assert_eq!(
            share(32, 32, edge),
            (8.0 * 16.0 + 4.0 * (8.0 + 4.0 + 2.0)) / 1024.0
        );
        // Between two patches no cell is lost.
        let between = |column: u32, _: u32| if column < 16 { 0 } else { 200 };
        assert_eq!(share(32, 32, between), 4.0 * 4.0 / 1024.0);
    }

    #[test]
    fn waves_twice_as_long_ask_for_less() {
        let waves = |px: f64| {
            share(320, 320, |column, row| {
                let at = |index: u32| (f64::from(index) * std::f64::consts::TAU / px).sin();
                (128.0 + 50.0 * at(column) + 50.0 * at(row)).round() as u8
            })
        };
        let shares = [10.0, 20.0, 40.0, 80.0, 160.0, 320.0].map(waves);
        assert!(
            shares.is_sorted_by(|shorter, longer| longer < shorter),
            "{shares:?}"
        );
        assert!(shares[0] > 0.5 && shares[5] < 0.05, "{shares:?}");
    }

    #[test]
    fn photos_without_a_block_count_whole_and_so_do_thinned_ones() {
        assert_eq!(detail(&[]).value, 1.0);
        assert_eq!(share(31, 500, |_, _| 7), 1.0);
        let image = Image::from_fn(64, 64, |_, _| [7; 3]);
        let thinned = View {
            image: Pixels::thinned(image, None, 2, 0, 0),
            ..photo(64, 64, |_, _| 7)
        };
        assert_eq!(detail(&[thinned]).value, 1.0);
    }

    proptest! {
        #[test]
        fn it_is_a_share_of_any_photos(
            width in 1_u32..200, height in 1_u32..200, seed in any::<u32>(), count in 1_usize..4, mask in any::<u8>(),
        ) {
            let gray = |column: u32, row: u32| (column.wrapping_mul(seed) ^ row.wrapping_mul(seed >> 7)) as u8 & mask;
            let views = vec![photo(width, height, gray); count];
            let found = detail(&views).value;
            prop_assert!((4.0 / 1024.0..=1.0).contains(&found), "{}", found);
        }
    }
}

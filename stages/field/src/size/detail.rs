//! How much detail the surface has in photos: the numbers of the bilinear patches that draw it.

use marf_numeric::grouped;
use nalgebra::Vector3;

use super::choice::Choice;
use crate::View;

/// Sides of the largest and of the smallest patch, pixels. A smallest one that does not fit takes a cell a
/// pixel.
const LARGEST: usize = 32;
const SMALLEST: usize = 4;
/// A patch draws its pixels if each is this near, gray levels: rounding to 8 bits takes half of one.
const TOLERANCE: f64 = 1.5;
/// Numbers of a bilinear patch: its corners.
const CORNERS: usize = 4;
/// Blocks of the largest side that are looked at, about: of all photos, the same share of each.
const BLOCKS: usize = 2048;
/// Points by which blocks are chosen, about.
const POINTS: usize = 4096;

/// Returns how many numbers a pixel the surface takes in the photos, in (0, 1]: 1 where every pixel differs
/// from its neighbours, 1/256 for a plain slope.
///
/// Three quarters of the blocks of 32 x 32 pixels take no more. Blocks on the outline of a thing also hold
/// the space behind it, and would show less detail than the thing has. `points`: those by which the cells of
/// the surface are counted. Blocks with such a point count, not sky or ground without any. All do if there
/// are no points. Transparent pixels do not count, masked ones do. If no block remains, or photos are thinned
/// so that neighbours are gone, it is 1.
pub(super) fn detail(views: &[View], points: &[[f64; 3]]) -> Choice<f64> {
    let stride = points.len().div_ceil(POINTS).max(1);
    let points: Vec<_> = points.iter().step_by(stride).map(|p| Vector3::from(*p)).collect();
    let blocks: Vec<Block> = views.iter().flat_map(|view| blocks(view, &points)).collect();
    let seen = blocks.iter().step_by(blocks.len().div_ceil(BLOCKS).max(1));
    let mut shares: Vec<f64> = seen.map(Block::share).collect();
    shares.sort_unstable_by(f64::total_cmp);
    let Some(share) = shares.get((shares.len() * 3).div_ceil(4).saturating_sub(1)) else {
        let reason = format!(
            "no {LARGEST} x {LARGEST} neighbouring pixels of a photo show the surface: all pixels count"
        );
        return Choice::new(1.0, reason);
    };
    let shown = if points.is_empty() {
        ""
    } else {
        " with points of the surface"
    };
    let reason = format!(
        "three quarters of {} blocks of {LARGEST} x {LARGEST} pixels{shown} take at most {share:.3} numbers a pixel. The numbers are corners of bilinear patches of {SMALLEST} to {LARGEST} pixels a side, and single pixels, that draw them to within {TOLERANCE} gray levels",
        grouped(shares.len() as u64)
    );
    Choice::new(*share, reason)
}

/// Returns the whole blocks of a photo that show a point, or all without points, whose pixels are all kept and not all transparent, in the
/// order of its rows.
fn blocks<'a>(view: &'a View, points: &[Vector3<f64>]) -> Vec<Block<'a>> {
    let Some(pixels) = view.image.all() else {
        return Vec::new();
    };
    let (width, height) = (view.image.width as usize, view.image.height as usize);
    let [columns, rows] = [width / LARGEST, height / LARGEST];
    let mut shows = vec![points.is_empty(); columns * rows];
    for [x, y] in points.iter().filter_map(|point| view.pixel_of(point)) {
        let [column, row] = [x, y].map(|at| at as usize / LARGEST);
        if column < columns && row < rows {
            shows[row * columns + column] = true;
        }
    }
    let alpha = view.image.alpha();
    let opaque = |first: usize| match alpha {
        [] => LARGEST * LARGEST,
        _ => {
            let row = |row: usize| &alpha[first + row * width..][..LARGEST];
            (0..LARGEST).flat_map(row).filter(|alpha| **alpha > 0).count()
        }
    };
    let shown = (0..shows.len()).filter(|index| shows[*index]);
    let first = |index: usize| (index / columns * width + index % columns) * LARGEST;
    let block = |first: usize| Block {
        pixels: &pixels[first..],
        width,
        side: LARGEST,
        opaque: opaque(first),
    };
    shown
        .map(first)
        .map(block)
        .filter(|block| block.opaque > 0)
        .collect()
}

/// Square of a photo.
struct Block<'a> {
    /// Pixels of the photo from the first of the square on, `width` a row.
    pixels: &'a [[u8; 3]],
    width: usize,
    side: usize,
    /// Pixels of the whole block that are not transparent.
    opaque: usize,
}

impl Block<'_> {
    /// Returns the numbers a pixel, in (0, 1], of a whole block that is not all transparent.
    fn share(&self) -> f64 {
        (self.numbers() as f64 / self.opaque as f64).min(1.0)
    }

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
    use crate::pixels::Pixels;
    use crate::rng::{Purpose, random_numbers};

    const FOCAL_PX: f64 = 100.0;

    /// A photo of `[height, width]` gray levels.
    fn photo(width: u32, height: u32, gray: impl Fn(u32, u32) -> u8) -> View {
        let image = Image::from_fn(width, height, |column, row| [gray(column, row); 3]);
        View {
            id: "photo".into(),
            camera: Camera::pinhole(width, height, FOCAL_PX),
            cam_from_world: Pose::identity(),
            image: image.into(),
            distances: Vec::new(),
        }
    }

    /// A point in the middle of every whole block from a column on.
    fn points(width: u32, height: u32, from: u32) -> Vec<[f64; 3]> {
        let middles =
            |from: u32, length: u32| (from / 32..length / 32).map(|block| f64::from(block * 32 + 16));
        let at = |pixel: f64, length: u32| (pixel - f64::from(length) / 2.0) / FOCAL_PX;
        let columns = middles(from, width).map(|x| at(x, width));
        columns
            .flat_map(|x| middles(0, height).map(move |y| [x, at(y, height), 1.0]))
            .collect()
    }

    fn share(width: u32, height: u32, gray: impl Fn(u32, u32) -> u8) -> f64 {
        detail(&[photo(width, height, gray)], &points(width, height, 0)).value
    }

    fn noise(column: u32, row: u32) -> u8 {
        random_numbers(1, Purpose::Thinning, column.into(), row.into()).below(256) as u8
    }

    #[test]
    fn slopes_take_a_patch_a_block_and_noise_a_cell_a_pixel() {
        let block = 4.0 / 1024.0;
        assert_eq!(share(64, 64, |_, _| 7), block);
        assert_eq!(share(64, 64, |column, row| (2 * column + row) as u8), block);
        assert_eq!(share(32, 32, |column, row| (column * row / 4) as u8), block);
        assert_eq!(share(64, 64, noise), 1.0);
    }

    /// A toy on a plain ground is as detailed as the toy.
    #[test]
    fn what_shows_no_point_does_not_count() {
        let toy = [photo(
            128,
            64,
            |column, row| if column < 64 { 255 } else { noise(column, row) },
        )];
        assert_eq!(detail(&toy, &points(128, 64, 64)).value, 1.0);
        // Half of the blocks show the toy. Then two of twelve do, and two of them half of it.
        assert_eq!(detail(&toy, &points(128, 64, 0)).value, 1.0);
        let wide = photo(
            192,
            64,
            |column, row| if column < 144 { 255 } else { noise(column, row) },
        );
        assert_eq!(
            detail(&[wide], &points(192, 64, 0)).value,
            (2.0 * 4.0 + 512.0) / 1024.0
        );
        let behind = points(128, 64, 0).into_iter().map(|[x, y, z]| [x, y, -z]);
        assert_eq!(detail(&toy, &behind.collect::<Vec<_>>()).value, 1.0);
        let beside = detail(&toy, &[[10.0, 0.0, 1.0], [f64::NAN; 3]]);
        assert!(
            beside.value == 1.0 && beside.reason.starts_with("no 32 x 32"),
            "{beside:?}"
        );
    }

    /// Of a toy in front of nothing, the toy alone counts. A photo of nothing has no detail.
    #[test]
    fn what_is_transparent_does_not_count() {
        let with_alpha = |alpha: &dyn Fn(u32) -> u8| {
            let mut view = photo(
                64,
                32,
                |column, row| if column < 48 { 0 } else { noise(column, row) },
            );
            let alphas: Vec<u8> = (0..64 * 32).map(|index| alpha(index % 64)).collect();
            view.image = view.image.with_alpha(&alphas);
            detail(&[view], &[]).value
        };
        let toy = with_alpha(&|column| if column < 48 { 0 } else { 200 });
        // Of the block with the toy, patches of 16 without it take 8 numbers.
        assert_eq!(toy, 1.0);
        let whole = with_alpha(&|_| 255);
        assert_eq!(whole, (2.0 * 4.0 + 512.0) / 1024.0);
        assert_eq!(with_alpha(&|_| 0), 1.0);
    }

    #[test]
    fn an_edge_takes_small_patches_only_where_it_is() {
        // The edge is in the third column of patches of 4: those 8 take 16 cells each. The 8 to their right,
        // 4 of 8 pixels to their left, and 2 of 16 on the other half hold none of it.
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
        assert_eq!(detail(&[], &points(64, 64, 0)).value, 1.0);
        assert_eq!(detail(&[photo(64, 64, |_, _| 7)], &[]).value, 4.0 / 1024.0);
        assert_eq!(share(31, 500, |_, _| 7), 1.0);
        let image = Image::from_fn(64, 64, |_, _| [7; 3]);
        let thinned = View {
            image: Pixels::thinned(image, None, 2, 0, 0),
            ..photo(64, 64, |_, _| 7)
        };
        assert_eq!(detail(&[thinned], &points(64, 64, 0)).value, 1.0);
    }

    proptest! {
        #[test]
        fn it_is_a_share_of_any_photos(
            width in 1_u32..200, height in 1_u32..200, seed in any::<u32>(), count in 1_usize..4, mask in any::<u8>(),
        ) {
            let gray = |column: u32, row: u32| (column.wrapping_mul(seed) ^ row.wrapping_mul(seed >> 7)) as u8 & mask;
            let views = vec![photo(width, height, gray); count];
            let found = detail(&views, &points(width, height, 0)).value;
            prop_assert!((4.0 / 1024.0..=1.0).contains(&found), "{}", found);
        }
    }
}

//! Colour conversion in integers.

use marf_scene::{Image, Srgb};

/// Coefficients in units of 2^-16.
const BITS: u32 = 16;
/// Luma: 219/255 x (0.2126, 0.7152, 0.0722), BT.709-6 section 3 (items 3.2 and 3.4), limited range.
const LUMA: [i32; 3] = [11_966, 40_254, 4_064];
/// Blue difference: 224/255 x (B - Y) / 1.8556. The sum is 0: gray stays gray.
const BLUE: [i32; 3] = [-6_596, -22_189, 28_785];
/// Red difference: 224/255 x (R - Y) / 1.5748. The sum is 0.
const RED: [i32; 3] = [28_785, -26_146, -2_639];

/// A picture in planes: luma at every pixel, chroma at every block of 2 x 2, both sides even.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Yuv {
    /// Pixels a row of luma.
    pub width: usize,
    /// Rows of luma.
    pub height: usize,
    /// `[height * width]`, 16 (black) to 235 (white).
    pub y: Vec<u8>,
    /// `[height/2 * width/2]`, 16 to 240, 128 is gray.
    pub cb: Vec<u8>,
    /// As `cb`.
    pub cr: Vec<u8>,
}

impl Yuv {
    /// Converts a picture to BT.709 of limited range (black 16, white 235), 4:2:0.
    ///
    /// The chroma of a block is that of the mean of its four pixels: sited at the middle of the block. A side that is odd
    /// or below 16 grows by repeating its last column or row: in 4:2:0 H.264 can crop by pairs only, and OpenH264 takes no less.
    pub fn from_image(picture: &Image<Srgb>) -> Self {
        let (width, height) = (side(picture.width), side(picture.height));
        let at =
            |column: u32, row: u32| picture.at(column.min(picture.width - 1), row.min(picture.height - 1));
        let mut yuv = Self {
            width: width as usize,
            height: height as usize,
            y: Vec::with_capacity((width * height) as usize),
            cb: Vec::with_capacity((width * height / 4) as usize),
            cr: Vec::with_capacity((width * height / 4) as usize),
        };
        for row in 0..height {
            yuv.y.extend((0..width).map(|column| luma(at(column, row))));
        }
        for row in (0..height).step_by(2) {
            for column in (0..width).step_by(2) {
                let block =
                    [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(right, down)| at(column + right, row + down));
                let (cb, cr) = chroma(&block);
                yuv.cb.push(cb);
                yuv.cr.push(cr);
            }
        }
        yuv
    }
}

/// Least side of a picture that OpenH264 takes, pixels: that of a block.
const MIN_PX: u32 = 16;

/// Returns the side of the video for a side of its pictures: the least even number that is not below, at least 16.
pub(crate) fn side(side_px: u32) -> u32 {
    side_px.next_multiple_of(2).max(MIN_PX)
}

/// Returns the luma of a pixel, rounded half up, in [16, 235].
fn luma(rgb: [u8; 3]) -> u8 {
    let half = 1 << (BITS - 1);
    (16 + ((weighted(&LUMA, rgb.map(i32::from)) + half) >> BITS)) as u8
}

/// Returns both colour differences of the mean of four pixels, rounded half up, in [16, 240].
fn chroma(block: &[[u8; 3]; 4]) -> (u8, u8) {
    let sum = [0, 1, 2].map(|channel| block.iter().map(|rgb| i32::from(rgb[channel])).sum::<i32>());
    // Two bits more: the sum is four times the mean.
    let half = 1 << (BITS + 1);
    let scaled = |of: &[i32; 3]| (128 + ((weighted(of, sum) + half) >> (BITS + 2))) as u8;
    (scaled(&BLUE), scaled(&RED))
}

fn weighted(weights: &[i32; 3], rgb: [i32; 3]) -> i32 {
    weights
        .iter()
        .zip(rgb)
        .map(|(weight, value)| weight * value)
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_one_color(rgb: [u8; 3]) -> (u8, u8, u8) {
        let yuv = Yuv::from_image(&Image::from_fn(2, 2, |_, _| rgb));
        assert!(yuv.y.iter().all(|luma| *luma == yuv.y[0]), "{rgb:?}");
        (yuv.y[0], yuv.cb[0], yuv.cr[0])
    }

    /// Pure red: Y = 16 + 219 x 0.2126 = 62.56, Cb = 128 - 112 x 0.2126 / 0.9278 = 102.34, Cr = 128 + 112 = 240.
    #[test]
    fn colors_have_the_values_of_the_standard() {
        for (rgb, expected) in [
            ([0, 0, 0], (16, 128, 128)),
            ([255, 255, 255], (235, 128, 128)),
            ([128, 128, 128], (126, 128, 128)),
            ([255, 0, 0], (63, 102, 240)),
            ([0, 255, 0], (173, 42, 26)),
            ([0, 0, 255], (32, 240, 118)),
            ([255, 255, 0], (219, 16, 138)),
        ] {
            assert_eq!(of_one_color(rgb), expected, "{rgb:?}");
        }
    }

    /// The formulas of BT.709-6 in floats.
    #[test]
    fn every_color_is_within_one_of_the_exact_value() {
        let levels: Vec<u8> = (0..=255).step_by(15).collect();
        for (red, green, blue) in levels.iter().flat_map(|r| {
            levels
                .iter()
                .flat_map(|g| levels.iter().map(|b| (*r, *g, *b)))
                .collect::<Vec<_>>()
        }) {
            let [r, g, b] = [red, green, blue].map(|level| f64::from(level) / 255.0);
            let y = 0.2126 * r + 0.7152 * g + 0.0722 * b;
            let exact = [
                16.0 + 219.0 * y,
                128.0 + 224.0 * (b - y) / 1.8556,
                128.0 + 224.0 * (r - y) / 1.5748,
            ];
            let (y, cb, cr) = of_one_color([red, green, blue]);
            for (found, exact) in [y, cb, cr].into_iter().zip(exact) {
                let off = (f64::from(found) - exact).abs();
                assert!(off <= 0.51, "{red} {green} {blue}: {found}, exactly {exact}");
            }
        }
    }

    #[test]
    fn gray_has_no_color_at_any_level() {
        for level in 0..=255 {
            let (_, cb, cr) = of_one_color([level; 3]);
            assert_eq!((cb, cr), (128, 128), "{level}");
        }
    }

    #[test]
    fn odd_and_small_sides_repeat_their_last_column_and_row() {
        for (width, height, sides) in [(17, 19, (18, 20)), (3, 1, (16, 16)), (16, 40, (16, 40))] {
            let picture = Image::from_fn(width, height, |column, row| [(column * 9 + row) as u8; 3]);
            let yuv = Yuv::from_image(&picture);
            assert_eq!((yuv.width, yuv.height), sides, "{width} x {height}");
            let at = |column: u32, row: u32| yuv.y[row as usize * yuv.width + column as usize];
            assert_eq!(at(sides.0 as u32 - 1, 0), at(width - 1, 0), "{width} x {height}");
            assert_eq!(at(0, sides.1 as u32 - 1), at(0, height - 1), "{width} x {height}");
            let blocks = yuv.width * yuv.height / 4;
            assert_eq!((yuv.cb.len(), yuv.cr.len()), (blocks, blocks));
        }
    }

    #[test]
    fn a_block_has_the_chroma_of_its_mean() {
        let half_red = Image::from_fn(2, 2, |column, _| if column == 0 { [255, 0, 0] } else { [0; 3] });
        let yuv = Yuv::from_image(&half_red);
        assert_eq!((yuv.y[0], yuv.y[1]), (63, 16));
        assert_eq!((yuv.cb[0], yuv.cr[0]), (115, 184));
    }
}

//! Which pixels may hold features.

use marf_numeric::visit_parts;
use marf_scene::{Image, Srgb};

/// Which pixels may hold features, one flag for each pixel of the working size.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mask {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Row by row: whether a feature may be there.
    pub open: Vec<bool>,
}

/// Smallest area that counts as missing or saturated and not merely dark or bright, pixels of the working size: 16 x 16.
const AREA: usize = 256;
/// From this value on a channel is saturated: JPEG moves 255 by a step or two.
const SATURATED: u8 = 253;

impl Mask {
    /// Returns the mask of a photo, which closes black areas, saturated areas, and the closed parts of a mask file.
    ///
    /// A working pixel is black (saturated) if all its `factor` x `factor` pixels are 0 (253 or more) in every
    /// channel. At least 256 such pixels that are connected by their sides are an area. The file may have any size
    /// and is read at the nearest pixel. Black there is closed. A file without pixels closes nothing.
    pub fn from_photo(photo: &Image<Srgb>, factor: u32, file: Option<&Image<Srgb>>) -> Self {
        let factor = factor.max(1);
        let (width, height) = (photo.width / factor, photo.height / factor);
        let mut open = vec![true; width as usize * height as usize];
        let black = boxes(photo, factor, |channel| channel == 0);
        let saturated = boxes(photo, factor, |channel| channel >= SATURATED);
        for kind in [black, saturated] {
            visit_parts(
                &kind,
                width as usize,
                |_, _| true,
                |area| {
                    if area.len() >= AREA {
                        area.iter().for_each(|&pixel| open[pixel] = false);
                    }
                },
            );
        }
        if let Some(file) = file.filter(|file| file.width > 0 && file.height > 0) {
            close_file(file, width, height, &mut open);
        }
        Self { width, height, open }
    }
}

/// Returns for each working pixel whether `is` holds for all channels of its box.
fn boxes(photo: &Image<Srgb>, factor: u32, is: impl Fn(u8) -> bool) -> Vec<bool> {
    let (width, factor) = (photo.width as usize, factor as usize);
    let columns = width / factor;
    let mut all = Vec::with_capacity(columns * (photo.height as usize / factor));
    for rows in photo.pixels.chunks_exact((width * factor).max(1)) {
        let first = all.len();
        // Most rows have no such byte. This check runs many bytes at a time.
        let any = rows
            .as_flattened()
            .iter()
            .fold(false, |any, &channel| any | is(channel));
        all.resize(first + columns, any);
        for row in rows.chunks_exact(width).filter(|_| any) {
            for (all, pixels) in all[first..].iter_mut().zip(row.chunks_exact(factor)) {
                *all &= pixels.as_flattened().iter().all(|&channel| is(channel));
            }
        }
    }
    all
}

/// Closes the black parts of a mask file.
fn close_file(file: &Image<Srgb>, width: u32, height: u32, open: &mut [bool]) {
    // The pixel of the file under the centre of a working pixel.
    let under =
        |at: usize, from: u32, to: u32| ((2 * at as u64 + 1) * u64::from(from) / (2 * u64::from(to))) as u32;
    for (index, open) in open.iter_mut().enumerate() {
        let (column, row) = (index % width as usize, index / width as usize);
        *open &= file.at(under(column, file.width, width), under(row, file.height, height)) != [0; 3];
    }
}

/// Summed-area table of the closed pixels.
pub(super) struct ClosedPixels {
    width: usize,
    height: usize,
    /// `[height + 1][width + 1]`: closed pixels above and left. Empty if all is open.
    sums: Vec<u32>,
}

impl ClosedPixels {
    /// Sums the closed pixels of a mask.
    pub(super) fn new(mask: &Mask) -> Self {
        let (width, height) = (mask.width as usize, mask.height as usize);
        let mut table = Self {
            width,
            height,
            sums: Vec::new(),
        };
        if mask.open.iter().all(|&open| open) {
            return table;
        }
        table.sums = vec![0; (width + 1) * (height + 1)];
        for (row, open) in mask.open.chunks_exact(width).enumerate() {
            let mut closed = 0;
            for (column, &open) in open.iter().enumerate() {
                closed += u32::from(!open);
                let at = (row + 1) * (width + 1) + column + 1;
                table.sums[at] = table.sums[at - width - 1] + closed;
            }
        }
        table
    }

    /// Whether all pixels within one scale of a point are open: the border of a closed area gives no feature.
    pub(super) fn allows(&self, [x_px, y_px]: [f32; 2], scale_px: f32) -> bool {
        if self.sums.is_empty() {
            return true;
        }
        // A float below 0 becomes 0.
        let span = |at: f32, len: usize| {
            let first = ((at - scale_px) as usize).min(len);
            (first, ((at + scale_px) as usize + 1).clamp(first, len))
        };
        let ((left, right), (top, bottom)) = (span(x_px, self.width), span(y_px, self.height));
        let sum = |row: usize, column: usize| self.sums[row * (self.width + 1) + column];
        sum(bottom, right) + sum(top, left) == sum(top, right) + sum(bottom, left)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn closed(mask: &Mask) -> usize {
        mask.open.iter().filter(|&&open| !open).count()
    }

    #[test]
    fn large_black_and_saturated_areas_are_closed_small_ones_and_dark_ones_are_not() {
        let photo = Image::from_fn(200, 100, |x, y| match (x, y) {
            (0..20, _) => [0; 3],
            (180.., _) => [255, 253, 254],
            (60..70, 0..10) => [0; 3],
            (100..140, _) => [0, 0, 1],
            _ => [120; 3],
        });
        for (factor, expected) in [(1, 4000), (2, 1000), (0, 4000)] {
            let mask = Mask::from_photo(&photo, factor, None);
            assert_eq!(closed(&mask), expected, "factor {factor}");
            assert!(
                !mask.open[0] && mask.open[mask.width as usize / 2],
                "factor {factor}"
            );
        }
        // 15 x 17 = 255 pixels are too few, 16 x 16 are enough.
        for (width, height, expected) in [(15, 17, 0), (16, 16, 256), (1, 1, 0), (0, 0, 0)] {
            let black = Mask::from_photo(&Image::from_fn(width, height, |_, _| [0; 3]), 1, None);
            assert_eq!(closed(&black), expected, "{width} x {height}");
        }
    }

    #[test]
    fn a_file_of_another_size_closes_its_black_half() {
        let photo = Image::from_fn(90, 40, |_, _| [99; 3]);
        for width in [2, 10, 90, 360] {
            let file = Image::from_fn(width, 3, |x, _| [if x < width / 2 { 0 } else { 255 }; 3]);
            let mask = Mask::from_photo(&photo, 2, Some(&file));
            // 45 columns: the centre of the 23rd lies on the half and belongs to the right.
            assert_eq!(closed(&mask), 22 * 20, "{width}");
            assert!(!mask.open[21] && mask.open[22], "{width}");
        }
    }

    #[test]
    fn a_point_within_one_scale_of_a_closed_pixel_is_refused() {
        let mut mask = Mask::from_photo(&Image::from_fn(20, 20, |_, _| [99; 3]), 1, None);
        assert!(ClosedPixels::new(&mask).allows([10.5, 10.5], 100.0));
        mask.open[10 * 20 + 10] = false;
        let table = ClosedPixels::new(&mask);
        for (x_px, scale_px, expected) in [
            (10.5, 0.0, false),
            (13.5, 2.0, true),
            (13.5, 2.6, false),
            (8.0, 2.5, false),
        ] {
            assert_eq!(
                table.allows([x_px, 10.5], scale_px),
                expected,
                "{x_px} {scale_px}"
            );
        }
        assert!(table.allows([-50.0, 1e9], 1.0));
    }
}

//! The descriptor of a view: a small summary of a photo that is compared to find duplicates.

use marf_cache::Digest;
use marf_scene::{Image, Srgb};
use serde::{Deserialize, Serialize};

use crate::bytes::digest;
use crate::decoded::DecodedPhoto;
use crate::hash::{self, SIDE};
use crate::luma::luma;

/// Cells a side of the small images that are compared. At 64, video neighbours of the rover set correlate up to 0.94
/// and copies at least 0.99. At 48, neighbours reach 0.96.
pub(crate) const CELLS: usize = 64;
/// Steps a unit of relative gradient. A gradient of 2.65 and more is 255.
const GRADIENT_STEPS: f64 = 96.0;
/// Added to the mean brightness a gradient is divided by, in 8-bit steps, so that noise in black stays small.
const DARK: f64 = 4.0;

/// A summary of a photo that recognises two photos of the same view. The compared images are a blob of their own, so
/// that only those of candidates are read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct ViewDescriptor {
    /// Size of the upright photo.
    pub(crate) size: PixelSize,
    /// Laplacian energy inside the blocks of JPEG times the squared number of pixels: scaled copies are compared in
    /// units of the scene, and block edges do not count as detail.
    pub(crate) sharpness: f64,
    /// Mean difference of colours inside the photo, in [0, 1]. Near 0 it is gray or seen through one narrow band.
    pub(crate) colour: f64,
    /// Perceptual hashes, each once: of the brightness, then of each band.
    pub(crate) hashes: Vec<u64>,
    /// Digest of the gradient magnitudes by band, `CELLS * CELLS` bytes each. One band if the file has one.
    #[serde(with = "digest")]
    pub(crate) planes: Digest,
}

/// Width and height of a photo, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct PixelSize {
    pub(crate) width: u32,
    pub(crate) height: u32,
}

impl ViewDescriptor {
    /// Computes the descriptor of a photo, and the bytes that [`ViewDescriptor::planes`] names.
    pub(crate) fn from_photo(decoded: &DecodedPhoto<'_>) -> (Self, Vec<u8>) {
        let image = &decoded.photo.image;
        let bands = if decoded.photo.bands == 1 { 1 } else { 3 };
        let means = Grid::from_image(image);
        let area = f64::from(image.width) * f64::from(image.height);
        let brightness = means.hash(|cell| luma(cell.map(eight_bits)));
        let by_band = (0..bands).map(|band| means.hash(|cell| eight_bits(cell[band])));
        let mut hashes = vec![brightness];
        for hash in by_band {
            if !hashes.contains(&hash) {
                hashes.push(hash);
            }
        }
        let planes: Vec<u8> = (0..bands).flat_map(|band| means.gradient(band)).collect();
        let descriptor = Self {
            size: PixelSize {
                width: image.width,
                height: image.height,
            },
            sharpness: decoded.laplacian().detail * area * area,
            colour: means.colour(),
            hashes,
            planes: Digest::from_content(&planes),
        };
        (descriptor, planes)
    }
}

/// The means of an image over `CELLS * CELLS` cells, for any aspect ratio.
struct Grid {
    /// `[CELLS * CELLS]` means by band in steps of 1/16, in [0, 4080].
    cells: Vec<[u32; 3]>,
}

impl Grid {
    fn from_image(image: &Image<Srgb>) -> Self {
        let (width, height) = (image.width as usize, image.height as usize);
        let columns: Vec<_> = (0..CELLS).map(|cell| bounds(cell, CELLS, width)).collect();
        let mut cells = Vec::with_capacity(CELLS * CELLS);
        let (mut sums, mut few) = (vec![0_u32; 3 * width], vec![0_u16; 3 * width]);
        for row in 0..CELLS {
            let (top, bottom) = bounds(row, CELLS, height);
            sums.fill(0);
            // The sums of 257 rows fit in 16 bits.
            for rows in image.pixels[top * width..bottom * width].chunks(257 * width) {
                few.fill(0);
                for pixels in rows.chunks_exact(width) {
                    let channels = pixels.as_flattened();
                    few.iter_mut()
                        .zip(channels)
                        .for_each(|(sum, value)| *sum += u16::from(*value));
                }
                sums.iter_mut()
                    .zip(&few)
                    .for_each(|(sum, few)| *sum += u32::from(*few));
            }
            for &(left, right) in &columns {
                let area = ((bottom - top) * (right - left)) as u64;
                let sum = |band: usize| {
                    let sums = &sums[3 * left..3 * right];
                    sums.iter()
                        .skip(band)
                        .step_by(3)
                        .map(|sum| u64::from(*sum))
                        .sum::<u64>()
                };
                cells.push([0, 1, 2].map(|band| ((16 * sum(band) + area / 2) / area) as u32));
            }
        }
        Self { cells }
    }

    /// Returns the perceptual hash of `value` on the means of 2 x 2 cells.
    fn hash(&self, value: impl Fn([u32; 3]) -> u8) -> u64 {
        let mut values = [0; SIDE * SIDE];
        for (at, out) in values.iter_mut().enumerate() {
            let (x, y) = (2 * (at % SIDE), 2 * (at / SIDE));
            let near = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| self.cells[(y + dy) * CELLS + x + dx]);
            let mean = |band: usize| (near.iter().map(|cell| cell[band]).sum::<u32>() + 2) / 4;
            *out = i64::from(value([mean(0), mean(1), mean(2)]));
        }
        hash::dct(&values)
    }

    /// Returns the cell at an offset from (x, y), clamped to the edge.
    fn neighbour(&self, x: usize, y: usize, dx: isize, dy: isize) -> [u32; 3] {
        let clamp = |at: usize, by: isize| at.saturating_add_signed(by).min(CELLS - 1);
        self.cells[clamp(y, dy) * CELLS + clamp(x, dx)]
    }

    /// Returns the Sobel gradient magnitude of every cell, divided by the local mean: it stays the same where light or a
    /// colour filter changes the brightness by a factor.
    fn gradient(&self, band: usize) -> Vec<u8> {
        let cell = |index: usize| self.relative_gradient(index % CELLS, index / CELLS, band);
        (0..self.cells.len()).map(cell).collect()
    }

    /// Returns the value of [`Grid::gradient`] for one cell.
    fn relative_gradient(&self, x: usize, y: usize, band: usize) -> u8 {
        let at = |dx, dy| i64::from(self.neighbour(x, y, dx, dy)[band]);
        let across = at(1, -1) + 2 * at(1, 0) + at(1, 1) - at(-1, -1) - 2 * at(-1, 0) - at(-1, 1);
        let down = at(-1, 1) + 2 * at(0, 1) + at(1, 1) - at(-1, -1) - 2 * at(0, -1) - at(1, -1);
        let sum: i64 = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| at(dx, dy))).sum();
        let mean = sum as f64 / 9.0 + 16.0 * DARK;
        let magnitude = ((across * across + down * down) as f64).sqrt();
        // Positive, so that adding a half and truncating rounds. `as` saturates at 255.
        (GRADIENT_STEPS * magnitude / mean + 0.5) as u8
    }

    /// Returns the mean of |r - b| / (r + b) over the cells, with red and blue each scaled to mean 1. It is 0 for
    /// gray photos and for one band with any tint.
    fn colour(&self) -> f64 {
        let sum = |band: usize| self.cells.iter().map(|cell| u64::from(cell[band])).sum::<u64>();
        let (reds, blues) = (sum(0), sum(2));
        let parts = self.cells.iter().map(|cell| {
            let (red, blue) = (u64::from(cell[0]) * blues, u64::from(cell[2]) * reds);
            if red + blue == 0 {
                0.0
            } else {
                red.abs_diff(blue) as f64 / (red + blue) as f64
            }
        });
        // Summed in the order of the cells, the same on every machine.
        parts.sum::<f64>() / self.cells.len() as f64
    }
}

/// Returns the range `[from, to)` of pixels along one side that a cell covers, at least one pixel.
fn bounds(cell: usize, side: usize, pixels: usize) -> (usize, usize) {
    let from = cell * pixels / side;
    (from, ((cell + 1) * pixels / side).max(from + 1))
}

/// Rounds a mean in steps of 1/16 to 8 bits.
fn eight_bits(sixteenths: u32) -> u8 {
    ((sixteenths + 8) / 16).min(255) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bytes::{from_bytes, to_bytes};

    fn descriptor(image: Image<Srgb>) -> ViewDescriptor {
        ViewDescriptor::from_photo(&DecodedPhoto::new(&image.into())).0
    }

    fn hills() -> Image<Srgb> {
        Image::from_fn(200, 150, |x, y| {
            let (x, y) = (x as i32, y as i32);
            let height = (x * x / 40 + y * y / 60 + (x / 9 * 37 + y / 7 * 91) % 64) % 200;
            [height as u8 + 30, (height / 2) as u8 + 40, (x % 50) as u8 + 20]
        })
    }

    #[test]
    fn a_descriptor_survives_its_bytes() {
        let descriptor = descriptor(hills());
        let bytes = to_bytes(&descriptor).unwrap();
        assert_eq!(from_bytes(&bytes), Some(descriptor));
        for cut in 0..bytes.len() {
            assert_eq!(from_bytes::<ViewDescriptor>(&bytes[..cut]), None, "cut at {cut}");
        }
        assert_eq!(from_bytes::<ViewDescriptor>(&[bytes, vec![7]].concat()), None);
    }

    /// The bands of a gray photo are its brightness: one hash is kept of the four.
    #[test]
    fn equal_hashes_are_kept_once() {
        let hills = hills();
        let gray = descriptor(Image::from_fn(200, 150, |x, y| [hills.at(x, y)[0]; 3]));
        assert_eq!(gray.hashes.len(), 1);
    }

    #[test]
    fn gray_and_one_tint_have_no_colour_and_a_coloured_photo_has() {
        let colour = |image: Image<Srgb>| descriptor(image).colour;
        let tinted = |[red, green, blue]: [f64; 3]| {
            let hills = hills();
            Image::from_fn(200, 150, |x, y| {
                let band = f64::from(hills.at(x, y)[0]);
                [red * band, green * band, blue * band].map(|value| value.round() as u8)
            })
        };
        assert_eq!(colour(tinted([1.0, 1.0, 1.0])), 0.0);
        assert!(
            colour(tinted([0.45, 0.6, 1.0])) < 0.003,
            "{}",
            colour(tinted([0.45, 0.6, 1.0]))
        );
        assert!(colour(hills()) > 0.1, "{}", colour(hills()));
    }

    /// By hand: cells of two pixels, one column and two rows each.
    #[test]
    fn cells_are_means_in_sixteenths() {
        let image = Image::from_fn(64, 128, |x, y| [(2 * x + y % 2) as u8, 0, 255]);
        let cells = Grid::from_image(&image).cells;
        for (at, cell) in cells.iter().enumerate() {
            assert_eq!(*cell, [32 * (at % 64) as u32 + 8, 0, 4080], "{at}");
        }
    }

    #[test]
    fn cells_of_an_image_smaller_than_the_grid_repeat_its_pixels() {
        let cells = Grid::from_image(&Image::from_fn(1, 1, |_, _| [9, 8, 7])).cells;
        assert!(cells.iter().all(|cell| *cell == [144, 128, 112]), "{cells:?}");
    }

    #[test]
    fn the_hash_does_not_ask_how_bright_a_photo_is_and_differs_for_its_mirror() {
        let hash = |image: Image<Srgb>| descriptor(image).hashes[0];
        let hills = hills();
        let dim = Image::from_fn(200, 150, |x, y| hills.at(x, y).map(|value| value / 2));
        let mirror = Image::from_fn(200, 150, |x, y| hills.at(199 - x, y));
        let distance = |other: Image<Srgb>| (hash(hills.clone()) ^ hash(other)).count_ones();
        let (dimmed, mirrored) = (distance(dim), distance(mirror));
        assert!(dimmed <= 4, "half the light: {dimmed} bits");
        assert!(mirrored >= 20, "mirrored: {mirrored} bits");
    }
}

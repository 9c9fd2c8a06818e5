//! A decoded photo with what several filters measure on.

use marf_scene::Photo;

use crate::luma::{Laplacian, Luma};

/// Fewest pixels of a sample, unless the photo has fewer.
const SAMPLE: usize = 1 << 18;

/// A decoded photo, and what several filters compute from it.
pub struct DecodedPhoto {
    /// The photo, of at least one pixel.
    pub photo: Photo,
    /// Its brightness.
    pub luma: Luma,
    /// Its second differences.
    pub(crate) laplacian: Laplacian,
}

impl DecodedPhoto {
    /// Takes a photo of at least one pixel and computes what several filters need.
    pub(crate) fn of(photo: Photo) -> Self {
        let luma = Luma::of(&photo.image);
        let laplacian = luma.laplacian();
        Self {
            photo,
            luma,
            laplacian,
        }
    }

    /// Returns a sample of pixels: each k-th pixel of each k-th row, 2^18 pixels and more of a larger photo.
    ///
    /// So many measure a share of 0.5 %; k is odd, so that every position of a Bayer mosaic occurs.
    pub fn sample(&self) -> impl Iterator<Item = [u8; 3]> + '_ {
        let image = &self.photo.image;
        let step = step(image.pixels.len());
        let rows = image.pixels.chunks_exact(image.width.max(1) as usize);
        rows.step_by(step)
            .flat_map(move |row| row.iter().step_by(step).copied())
    }
}

/// Returns the largest odd step that leaves at least [`SAMPLE`] pixels.
fn step(pixels: usize) -> usize {
    let mut step = 1;
    while pixels / ((step + 2) * (step + 2)) >= SAMPLE {
        step += 2;
    }
    step
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::Image;

    #[test]
    fn small_photos_are_counted_whole_and_large_ones_in_odd_steps() {
        assert_eq!(
            (step(0), step(1), step(9 * SAMPLE - 1), step(9 * SAMPLE)),
            (1, 1, 1, 3)
        );
        assert_eq!((step(1440 * 1920), step(400_000_000)), (3, 39));
        let decoded = |width, height| {
            DecodedPhoto::of(Photo {
                image: Image::from_fn(width, height, |x, y| [x as u8, y as u8, 7]),
                bands: 3,
                notes: Vec::new(),
            })
        };
        let small = decoded(31, 7);
        assert!(small.sample().eq(small.photo.image.pixels.iter().copied()));
        assert_eq!(decoded(1600, 1500).sample().count(), 534 * 500);
    }
}

//! A decoded photo with what several filters measure on.

use std::cell::OnceCell;

use marf_scene::Photo;

use crate::luma::{Laplacian, Luma};

/// Fewest pixels of a sample, unless the photo has fewer.
const SAMPLE: usize = 1 << 18;

/// A decoded photo, and what several filters compute from it, each when it is first asked for.
pub struct DecodedPhoto<'a> {
    /// The photo, of at least one pixel.
    pub photo: &'a Photo,
    luma: OnceCell<Luma>,
    laplacian: OnceCell<Laplacian>,
}

impl<'a> DecodedPhoto<'a> {
    /// Takes a photo of at least one pixel.
    pub(crate) fn new(photo: &'a Photo) -> Self {
        Self {
            photo,
            luma: OnceCell::new(),
            laplacian: OnceCell::new(),
        }
    }

    /// Returns its brightness.
    pub fn luma(&self) -> &Luma {
        self.luma.get_or_init(|| Luma::from_image(&self.photo.image))
    }

    /// Returns its second differences.
    pub(crate) fn laplacian(&self) -> &Laplacian {
        self.laplacian.get_or_init(|| self.luma().laplacian())
    }

    /// Returns a sample of pixels: each k-th pixel of each k-th row, 2^18 pixels and more of a larger photo.
    ///
    /// This number measures a share of 0.5 %. k is odd, so that every position of a Bayer mosaic occurs.
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
        let photo = |width, height| Photo::from(Image::from_fn(width, height, |x, y| [x as u8, y as u8, 7]));
        let small = photo(31, 7);
        assert!(
            DecodedPhoto::new(&small)
                .sample()
                .eq(small.image.pixels.iter().copied())
        );
        assert_eq!(DecodedPhoto::new(&photo(1600, 1500)).sample().count(), 534 * 500);
    }
}

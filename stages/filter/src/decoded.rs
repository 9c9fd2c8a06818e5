use marf_scene::Photo;

use crate::luma::{Laplacian, Luma};

/// Fewest pixels of a sample, where the photo has as many.
const SAMPLE: usize = 1 << 18;

/// A photo as the filters look at it: decoded once, with what several of them need.
pub struct DecodedPhoto {
    /// The photo, of at least one pixel.
    pub photo: Photo,
    /// Its brightness.
    pub luma: Luma,
    /// Its second differences.
    pub(crate) laplacian: Laplacian,
}

impl DecodedPhoto {
    /// Looks at a photo of at least one pixel.
    pub(crate) fn of(photo: Photo) -> Self {
        let luma = Luma::of(&photo.image);
        let laplacian = luma.laplacian();
        Self {
            photo,
            luma,
            laplacian,
        }
    }

    /// Returns pixels spread evenly over the photo, 2^18 and more of a larger one, enough to tell shares of 0.5 % by:
    /// each k-th of each k-th row, k odd so that all places of a Bayer mosaic are met.
    pub fn sample(&self) -> impl Iterator<Item = [u8; 3]> + '_ {
        let image = &self.photo.image;
        let step = step(image.pixels.len());
        let rows = image.pixels.chunks_exact(image.width.max(1) as usize);
        rows.step_by(step)
            .flat_map(move |row| row.iter().step_by(step).copied())
    }
}

/// Returns the largest odd step that leaves [`SAMPLE`] pixels.
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
        let look = |width, height| {
            DecodedPhoto::of(Photo {
                image: Image::from_fn(width, height, |x, y| [x as u8, y as u8, 7]),
                bands: 3,
                notes: Vec::new(),
            })
        };
        let small = look(31, 7);
        assert!(small.sample().eq(small.photo.image.pixels.iter().copied()));
        assert_eq!(look(1600, 1500).sample().count(), 534 * 500);
    }
}

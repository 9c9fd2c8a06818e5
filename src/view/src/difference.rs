//! Difference between a photo and the render of its pose.

use marf_scene::{Camera, Falloff, Frame, Image, Photo, Srgb};
use nalgebra::Vector2;

use crate::source::Source;

/// Upper end of the colour scale, difference of gray, white = 1: the same for all scenes, so that pictures of two can be compared.
pub const SCALE_END: f64 = 0.2;

/// A photo that renders of its pose are compared with.
#[derive(Debug)]
pub struct Reference {
    photo: Image<Srgb>,
    /// Pixels that are not white are hidden. `None` without a mask.
    mask: Option<Image<Srgb>>,
}

impl Reference {
    /// Reads a photo of a scene, with its mask, and takes the vignetting of its camera away, which renders do not have.
    ///
    /// # Errors
    /// One sentence: a file is lost, damaged or of another size.
    pub fn read(source: &dyn Source, frame: &Frame, falloff: Option<&Falloff>) -> Result<Self, String> {
        let file = &frame.file;
        let read = |digest| {
            let bytes = source
                .object(digest)
                .ok_or_else(|| format!("the store has lost {file} or its mask"))?;
            Photo::decode_validated(&bytes).map_err(|error| format!("{file}: {error}"))
        };
        let photo = read(&frame.image)?.image;
        let mask = frame.mask.as_ref().map(read).transpose()?.map(|mask| mask.image);
        let size = (frame.camera.width, frame.camera.height);
        let is_of_size = |image: &Image<Srgb>| (image.width, image.height) == size;
        if is_of_size(&photo) && mask.as_ref().is_none_or(is_of_size) {
            let photo = match falloff {
                Some(falloff) => without(falloff, &frame.camera, &photo),
                None => photo,
            };
            return Ok(Self { photo, mask });
        }
        Err(format!("{file} or its mask has another size than its camera"))
    }

    /// Returns |gray of a render - gray of the photo| of every pixel, white = 1. -1 where the mask hides any
    /// of it.
    ///
    /// A pixel of the render is compared with the mean of the photo's pixels that it covers, of a finer render with the one below it.
    pub fn differences(&self, render: &Image<Srgb>) -> Vec<f32> {
        let (columns, rows) = (
            spans(self.photo.width, render.width),
            spans(self.photo.height, render.height),
        );
        let mut differences = Vec::with_capacity(render.pixels.len());
        for (row, down) in rows.iter().enumerate() {
            for (column, across) in columns.iter().enumerate() {
                let covered = || down.clone().flat_map(|y| across.clone().map(move |x| (x, y)));
                let is_hidden = |(x, y)| self.mask.as_ref().is_some_and(|mask| mask.at(x, y) != [255; 3]);
                let of_photo: u32 = covered().map(|(x, y)| levels(self.photo.at(x, y))).sum();
                let mean = f64::from(of_photo) / covered().count() as f64;
                let own = f64::from(levels(render.at(column as u32, row as u32)));
                let difference = (own - mean).abs() / (3.0 * 255.0);
                differences.push(if covered().any(is_hidden) {
                    -1.0
                } else {
                    difference as f32
                });
            }
        }
        differences
    }
}

/// Returns a photo without the vignetting of its camera. Tones that would be above white are white.
fn without(falloff: &Falloff, camera: &Camera, photo: &Image<Srgb>) -> Image<Srgb> {
    Image::from_fn(photo.width, photo.height, |column, row| {
        let pixel = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let v = falloff.at(camera.radius2(&pixel));
        photo
            .at(column, row)
            .map(|tone| (f64::from(tone) / v + 0.5) as u8)
    })
}

fn levels(rgb: [u8; 3]) -> u32 {
    rgb.iter().map(|level| u32::from(*level)).sum()
}

/// Returns for each of `parts` pixels of a side those of `whole` that it covers, one at the least.
fn spans(whole: u32, parts: u32) -> Vec<std::ops::Range<u32>> {
    let at = |part: u32| (u64::from(part) * u64::from(whole) / u64::from(parts.max(1))) as u32;
    (0..parts)
        .map(|part| {
            let begin = at(part).min(whole.saturating_sub(1));
            begin..at(part + 1).max(begin + 1)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gray(width: u32, height: u32, level: impl Fn(u32, u32) -> u8) -> Image<Srgb> {
        Image::from_fn(width, height, |x, y| [level(x, y); 3])
    }

    #[test]
    fn a_pixel_is_compared_with_the_mean_of_what_it_covers() {
        let reference = Reference {
            photo: gray(4, 2, |x, _| if x % 2 == 0 { 100 } else { 200 }),
            mask: None,
        };
        // Means of 150 in both blocks.
        let found = reference.differences(&gray(2, 1, |x, _| if x == 0 { 150 } else { 99 }));
        assert!(
            found[0].abs() < 1e-6 && (found[1] - 51.0 / 255.0).abs() < 1e-6,
            "{found:?}"
        );
        let finer = reference.differences(&gray(8, 4, |x, _| if x / 2 % 2 == 0 { 100 } else { 200 }));
        assert!(finer.iter().all(|difference| *difference == 0.0), "{finer:?}");
    }

    /// v is 1 - r² / 4. r is 1 at the first pixel and 0 at the middle one, and 150 / 0.75 is 200.
    #[test]
    fn dark_corners_of_a_photo_are_no_difference() {
        let camera = Camera::pinhole(9, 1, 4.0);
        let falloff = Falloff {
            camera,
            factors: [-0.25, 0.0, 0.0],
            darkening: 0.3,
            sigma: 0.01,
            pairs: 1,
            spread: 0.1,
            noise: 0.05,
        };
        let plain = without(&falloff, &camera, &gray(9, 1, |_, _| 150));
        assert_eq!([0, 4].map(|column| plain.at(column, 0)), [[200; 3], [150; 3]]);
        let white = without(&falloff, &camera, &gray(9, 1, |_, _| 255));
        assert_eq!(white.at(0, 0), [255; 3]);
    }

    #[test]
    fn what_a_mask_hides_has_no_difference() {
        let reference = Reference {
            photo: gray(4, 4, |_, _| 0),
            mask: Some(gray(4, 4, |x, y| if (x, y) == (3, 3) { 0 } else { 255 })),
        };
        let found = reference.differences(&gray(2, 2, |_, _| 255));
        assert_eq!(found, [1.0, 1.0, 1.0, -1.0]);
    }

    #[test]
    fn every_pixel_covers_at_least_one() {
        for (whole, parts) in [(5, 3), (3, 5), (1, 7), (7, 1)] {
            let spans = spans(whole, parts);
            assert!(
                spans.iter().all(|span| !span.is_empty() && span.end <= whole),
                "{whole} {parts} {spans:?}"
            );
        }
        assert!(spans(5, 0).is_empty());
    }
}

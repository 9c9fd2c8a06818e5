//! A photo as it is trained on and judged by.

use std::borrow::Cow;

use marf_scene::{Camera, Falloff, Image, Srgb};
use nalgebra::Vector2;

/// A photo at its working size, with its camera.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ScaledPhoto {
    pub camera: Camera,
    /// Its pixels, over black.
    pub image: Image<Srgb>,
    /// Their opacities, `[height * width]`. Empty for an opaque photo.
    pub alpha: Vec<u8>,
    /// Pixels that its mask hides, `[height * width]`. Empty without a mask.
    pub hidden: Vec<bool>,
    /// That of its camera, if it is taken into account.
    pub falloff: Option<Falloff>,
}

impl ScaledPhoto {
    /// Returns the photo without the vignetting of its camera. Tones that would be above white are white.
    pub fn without_falloff(mut self) -> Self {
        if let Some(falloff) = self.falloff.take() {
            self.image = times(&self.image, |pixel| 1.0 / falloff.at(self.camera.radius2(pixel)));
        }
        self
    }

    /// Returns a picture of the field as the photo's camera shows it.
    pub fn with_falloff<'a>(&self, render: &'a Image<Srgb>) -> Cow<'a, Image<Srgb>> {
        let shown =
            |falloff: &Falloff| Cow::Owned(times(render, |pixel| falloff.at(self.camera.radius2(pixel))));
        self.falloff.as_ref().map_or(Cow::Borrowed(render), shown)
    }

    /// Returns only the middle pixels of boxes of an odd side, so that the longest side is at most `side_px`, or the shortest is one box.
    ///
    /// A field is as good on these pixels as on the whole photo. A shrunk photo lacks the details by which fields differ.
    pub fn thinned_to(&self, side_px: u32) -> Self {
        let longest = self.camera.width.max(self.camera.height);
        let shortest = self.camera.width.min(self.camera.height);
        let side = (longest.div_ceil(side_px) | 1).min(shortest.saturating_sub(1) | 1);
        // Its rays go through the middles of the boxes, which are middles of pixels.
        let camera = self.camera.box_reduced(side);
        let width = self.camera.width;
        Self {
            image: Image {
                width: camera.width,
                height: camera.height,
                pixels: middles(&self.image.pixels, width, side),
            },
            alpha: middles(&self.alpha, width, side),
            hidden: middles(&self.hidden, width, side),
            falloff: self.falloff,
            camera,
        }
    }
}

/// Returns a picture whose tones are multiplied, by the middles of pixels.
fn times(image: &Image<Srgb>, factor: impl Fn(&Vector2<f64>) -> f64) -> Image<Srgb> {
    Image::from_fn(image.width, image.height, |column, row| {
        let factor = factor(&Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5));
        image
            .at(column, row)
            .map(|tone| (f64::from(tone) * factor + 0.5) as u8)
    })
}

/// Returns the middles of boxes of an odd side of `[height * width]`, row by row. An empty slice gives an empty vector.
fn middles<T: Copy>(all: &[T], width: u32, side: u32) -> Vec<T> {
    let (width, side) = (width as usize, side as usize);
    let rows = all.chunks_exact(width).skip(side / 2).step_by(side);
    rows.take(all.len() / width / side)
        .flat_map(|row| row.iter().skip(side / 2).step_by(side).take(width / side))
        .copied()
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// v is 1 - r² / 4, and r is 1 at the first and the last pixel.
    #[test]
    fn a_photo_without_its_falloff_gets_it_back() {
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
        let raw = Image::from_fn(9, 1, |column, _| {
            [if column == 8 { 250 } else { 60 + 7 * column as u8 }; 3]
        });
        let photo = ScaledPhoto {
            camera,
            image: raw.clone(),
            alpha: Vec::new(),
            hidden: Vec::new(),
            falloff: Some(falloff),
        };
        let plain = photo.clone().without_falloff();
        // r is 1 at the first pixel, where v is 0.75, and 60 / 0.75 is 80. The last one would be brighter than white.
        assert_eq!(
            [0, 4, 8].map(|column| plain.image.at(column, 0)[0]),
            [80, 60 + 28, 255]
        );
        let back = photo.with_falloff(&plain.image);
        assert_eq!(back.pixels[..8], raw.pixels[..8]);
        assert_eq!(back.pixels[8], [191; 3]);
        assert_eq!(
            *plain.with_falloff(&raw),
            raw,
            "once taken away, it is no longer given"
        );
    }
}

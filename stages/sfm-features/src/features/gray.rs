//! Luminance of a photo at the working size.

use marf_scene::{Image, Srgb};

/// Luminance of a photo at the working size.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Gray {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// In [0, 1], row by row.
    pub pixels: Vec<f32>,
}

impl Gray {
    /// Returns the mean luma (Rec. 709 weights on the sRGB bytes as they are) of boxes of `factor` x `factor` pixels.
    ///
    /// The rest of the division is cut off at the right and the bottom. A factor of 0 is taken as 1.
    pub fn from_photo(photo: &Image<Srgb>, factor: u32) -> Self {
        let factor = factor.max(1) as usize;
        let (width, height) = (photo.width as usize / factor, photo.height as usize / factor);
        let scale = 1.0 / (255 * factor * factor) as f32;
        let mut pixels = Vec::with_capacity(width * height);
        let mut sums = vec![[0_u32; 3]; photo.width as usize];
        for rows in photo
            .pixels
            .chunks_exact((photo.width as usize * factor).max(1))
            .take(height)
        {
            sums.fill([0; 3]);
            for row in rows.chunks_exact(sums.len()) {
                let bytes = sums.as_flattened_mut().iter_mut().zip(row.as_flattened());
                bytes.for_each(|(sum, &byte)| *sum += u32::from(byte));
            }
            pixels.extend(
                sums.chunks_exact(factor)
                    .map(|columns| (luma(columns) * scale).min(1.0)),
            );
        }
        Self {
            width: width as u32,
            height: height as u32,
            pixels,
        }
    }

    /// Whether the number of pixels fits the size, and all are in [0, 1].
    pub(super) fn is_valid(&self) -> bool {
        let count = self.width as usize * self.height as usize;
        self.pixels.len() == count && self.pixels.iter().all(|pixel| (0.0..=1.0).contains(pixel))
    }
}

/// Returns the luma of the sum of some columns, which rounding may take above that of white.
fn luma(columns: &[[u32; 3]]) -> f32 {
    let sum = |channel: usize| columns.iter().map(|column| column[channel]).sum::<u32>() as f32;
    0.2126 * sum(0) + 0.7152 * sum(1) + 0.0722 * sum(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn luma_is_weighted_and_averaged_over_whole_boxes() {
        let photo = Image::<Srgb>::from_fn(5, 3, |x, y| {
            if y < 2 && x < 4 {
                [255, 0, 51 * x as u8]
            } else {
                [9; 3]
            }
        });
        let gray = Gray::from_photo(&photo, 2);
        assert_eq!((gray.width, gray.height), (2, 1));
        // Blue 0 and 0.2 on average 0.1, then 0.4 and 0.6 on average 0.5.
        for (pixel, blue) in gray.pixels.iter().zip([0.1, 0.5]) {
            assert!((pixel - (0.2126 + 0.0722 * blue)).abs() < 1e-6, "{pixel}");
        }
    }

    #[test]
    fn white_stays_in_range_and_nothing_is_nothing() {
        for factor in 0..=400 {
            let side_px = factor.max(16);
            let gray = Gray::from_photo(&Image::from_fn(side_px + 1, side_px, |_, _| [255; 3]), factor);
            assert!(
                gray.is_valid() && gray.pixels.iter().all(|&pixel| pixel > 0.999_999),
                "factor {factor}"
            );
        }
        for (width, height) in [(0, 0), (0, 3), (3, 0), (1, 1)] {
            let gray = Gray::from_photo(&Image::from_fn(width, height, |_, _| [0; 3]), 2);
            assert!(gray.is_valid() && gray.pixels.is_empty(), "{width} x {height}");
        }
    }
}

//! Small copies of photos, to be looked at.

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder, RgbImage, imageops};

use crate::photo::damaged;
use crate::{DecodeError, Image, Srgb};

/// Longest side of a thumbnail, pixels.
const THUMBNAIL_PX: u32 = 160;
/// JPEG quality of a thumbnail, in [1, 100].
const THUMBNAIL_QUALITY: u8 = 80;

/// Returns a photo as a JPEG of at most 160 pixels a side: some 5 KB.
///
/// # Errors
/// An image of zero pixels.
pub fn thumbnail(image: &Image<Srgb>) -> Result<Vec<u8>, DecodeError> {
    let small = shrunk(image, THUMBNAIL_PX);
    encode_jpeg(&small.unwrap_or_else(|| image.clone()), THUMBNAIL_QUALITY)
}

/// Encodes an image as JPEG of a quality in [1, 100]. Equal images give equal bytes.
///
/// # Errors
/// An image of zero pixels, or of more than 65,535 a side.
pub fn encode_jpeg(image: &Image<Srgb>, quality: u8) -> Result<Vec<u8>, DecodeError> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .write_image(
            image.pixels.as_flattened(),
            image.width,
            image.height,
            ExtendedColorType::Rgb8,
        )
        .map_err(|error| damaged("JPEG", &error))?;
    Ok(bytes)
}

/// Shrinks an image to a longest side of `most_px` pixels, never enlarges it. `None` without pixels.
pub fn shrunk(image: &Image<Srgb>, most_px: u32) -> Option<Image<Srgb>> {
    let longest = image.width.max(image.height);
    if image.width == 0 || image.height == 0 {
        return None;
    }
    if longest <= most_px {
        return Some(image.clone());
    }
    let side = |side: u32| {
        (u64::from(side) * u64::from(most_px))
            .div_ceil(u64::from(longest))
            .max(1) as u32
    };
    // A whole factor first: it is exact, and the rest of the resampling is small.
    let factor = (longest / most_px).clamp(1, image.width.min(image.height));
    let reduced = image.box_reduced(factor);
    if reduced.width.max(reduced.height) <= most_px {
        return Some(reduced);
    }
    let pixels = reduced.pixels.as_flattened().to_vec();
    let whole = RgbImage::from_raw(reduced.width, reduced.height, pixels)?;
    let small = imageops::thumbnail(&whole, side(image.width), side(image.height));
    Some(Image {
        width: small.width(),
        height: small.height(),
        pixels: small.pixels().map(|rgb| rgb.0).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Photo;

    #[test]
    fn a_picture_shrinks_to_its_longest_side_and_never_grows() {
        for ((width, height), shown) in [
            ((1440, 1920), (120, 160)),
            ((100, 50), (100, 50)),
            ((5000, 2), (160, 1)),
            ((160, 160), (160, 160)),
        ] {
            let image = Image::from_fn(width, height, |_, _| [9, 8, 7]);
            let small = shrunk(&image, 160).unwrap();
            assert_eq!((small.width, small.height), shown, "{width} x {height}");
            let photo = Photo::decode(&thumbnail(&image).unwrap()).unwrap();
            assert_eq!(
                (photo.image.width, photo.image.height),
                shown,
                "{width} x {height}"
            );
        }
    }

    #[test]
    fn a_picture_without_pixels_has_no_thumbnail() {
        let empty = Image::<Srgb>::from_fn(0, 4, |_, _| [0; 3]);
        assert_eq!(shrunk(&empty, 160), None);
        assert!(thumbnail(&empty).is_err());
    }
}

//! Decoding of JPEGs, strictly.

use image::metadata::Orientation;
use image::{DynamicImage, GrayImage, RgbImage};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;
use zune_jpeg::errors::DecodeErrors;

use super::decoded::{Alpha, DecodeError, Photo, TooLarge, damaged};
use super::other::upright;
use super::scan;

/// Most scans. Encoders write up to 20, and each takes the decoder as long as the whole picture.
const MAX_SCANS: usize = 64;

/// Decodes a JPEG strictly and requires its end marker: a file cut in half, or with a damaged scan, must not become training data. (The
/// `image` crate decodes with the same library, but leniently.) Bytes after the end marker are not part of the picture. Phones append a
/// film, others a second picture or zeros.
pub(super) fn decode(bytes: &[u8], limit_bytes: u64) -> Result<Photo, DecodeError> {
    let fail = |error: DecodeErrors| damaged("JPEG", &format!("{error:?}"));
    let Some(end) = scan::end(bytes) else {
        let message = "the end marker FF D9 is missing: the file is cut short";
        return Err(damaged("JPEG", &message));
    };
    let bytes = bytes.get(..end).unwrap_or(bytes);
    let scans = scan::count(bytes);
    if scans > MAX_SCANS {
        let message = format!("it has {scans} scans, above the limit of {MAX_SCANS}");
        return Err(damaged("JPEG", &message));
    }
    let options = options().set_strict_mode(true);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(fail)?;
    let (width, height) = decoder.dimensions().unwrap_or_default();
    let (width, height) = (width as u32, height as u32);
    TooLarge::check(width, height, 3, limit_bytes)?;
    let grey = decoder.input_colorspace() == Some(ColorSpace::Luma);
    let kept = if grey { ColorSpace::Luma } else { ColorSpace::RGB };
    decoder.set_options(options.jpeg_set_out_colorspace(kept));
    scan::check(bytes).map_err(|error| damaged("JPEG", &error))?;
    let pixels = decoder.decode().map_err(fail)?;
    let orientation = decoder.exif().and_then(|exif| Orientation::from_exif_chunk(exif));
    let orientation = orientation.unwrap_or(Orientation::NoTransforms);
    let turned = |decoded: DynamicImage| {
        let (decoded, notes) = upright(decoded, orientation);
        Photo::from_upright(decoded, Alpha::Straight, notes)
    };
    let photo = if grey {
        let decoded = GrayImage::from_raw(width, height, pixels).map(DynamicImage::from);
        decoded.map(turned)
    } else if orientation == Orientation::NoTransforms {
        Photo::from_pixels(width, height, pixels)
    } else {
        let decoded = RgbImage::from_raw(width, height, pixels).map(DynamicImage::from);
        decoded.map(turned)
    };
    photo.ok_or_else(|| damaged("JPEG", &"fewer pixels than its header says"))
}

/// Returns options that leave the limits to [`TooLarge::check`].
fn options() -> DecoderOptions {
    DecoderOptions::default()
        .set_max_width(usize::MAX)
        .set_max_height(usize::MAX)
}

/// Decodes an upright JPEG of three channels straight into its pixels. `None` for anything else, errors included.
///
/// The same decoder as in [`decode`], but without counting the units of the scan. Where it returns `None`, [`Photo::decode`] finds the error.
pub(super) fn decode_plain(bytes: &[u8]) -> Option<Photo> {
    let options = options()
        .set_strict_mode(false)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let bytes = bytes.get(..scan::end(bytes)?)?;
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().ok()?;
    let (width, height) = decoder.dimensions()?;
    let colour = matches!(decoder.input_colorspace()?, ColorSpace::YCbCr | ColorSpace::RGB);
    let turned = decoder
        .exif()
        .and_then(|exif| Orientation::from_exif_chunk(exif))
        .is_some_and(|orientation| orientation.to_exif() != 1);
    if !colour || turned {
        return None;
    }
    Photo::from_pixels(width as u32, height as u32, decoder.decode().ok()?)
}

#[cfg(test)]
mod tests;

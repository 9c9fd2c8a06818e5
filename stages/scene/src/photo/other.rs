//! Decoding of every format but JPEG, within limits of size and memory.

use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use tiff::tags::Tag;

use super::decoded::{DecodeError, MAX_DECODE_BYTES, MAX_SIDE, Photo, damaged, format_name};

/// Decodes a photo other than a JPEG with the `image` crate, within the limits of size and memory.
pub(super) fn decode(bytes: &[u8], format: ImageFormat) -> Result<(DynamicImage, Vec<String>), DecodeError> {
    let name = format_name(format).unwrap_or("image");
    let fail = |error: image::ImageError| damaged(name, &error);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_DECODE_BYTES);
    reader.limits(limits);
    let mut decoder = reader.into_decoder().map_err(fail)?;
    let (width, height) = decoder.dimensions();
    if decoder.total_bytes() > MAX_DECODE_BYTES {
        return Err(DecodeError::TooLarge { width, height });
    }
    let orientation = decoder.orientation().map_err(fail)?;
    let decoded = DynamicImage::from_decoder(decoder).map_err(fail)?;
    Ok(upright(decoded, orientation))
}

/// Decodes the first page of a TIFF.
///
/// Planes of their own are refused before they are decoded: `image` 0.25.10 panics on some that have 16 bits.
pub(super) fn decode_tiff(bytes: &[u8]) -> Result<Photo, DecodeError> {
    let fail = |error: tiff::TiffError| damaged("TIFF", &error);
    let mut decoder = tiff::decoder::Decoder::new(Cursor::new(bytes)).map_err(fail)?;
    let planes = decoder
        .find_tag_unsigned::<u16>(Tag::PlanarConfiguration)
        .map_err(fail)?;
    if planes.is_some_and(|planes| planes != CHUNKY) {
        let message = "its colours lie in planes of their own (PlanarConfiguration 2), which are not read: save it with pixels in one plane";
        return Err(damaged("TIFF", &message));
    }
    let (decoded, mut notes) = decode(bytes, ImageFormat::Tiff)?;
    if decoder.more_images() {
        notes.push("the first of several pages".to_owned());
    }
    Ok(Photo::from_upright(decoded, notes))
}

/// PlanarConfiguration of a TIFF whose pixels have their channels side by side.
const CHUNKY: u16 = 1;

/// Applies an EXIF orientation; returns the picture, and a note if it was turned.
pub(super) fn upright(mut decoded: DynamicImage, orientation: Orientation) -> (DynamicImage, Vec<String>) {
    let mut notes = Vec::new();
    if orientation.to_exif() != 1 {
        decoded.apply_orientation(orientation);
        notes.push(format!(
            "turned upright from EXIF orientation {}",
            orientation.to_exif()
        ));
    }
    (decoded, notes)
}

//! Decoding of every format but JPEG, within a limit of memory.

use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use super::decoded::{DecodeError, TooLarge, damaged, format_name};

/// Decodes a photo other than a JPEG with the `image` crate, within a limit of memory.
pub(super) fn decode(
    bytes: &[u8],
    format: ImageFormat,
    limit_bytes: u64,
) -> Result<(DynamicImage, Vec<String>), DecodeError> {
    let name = format_name(format).unwrap_or("image");
    let fail = |error: image::ImageError| damaged(name, &error);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(limit_bytes);
    reader.limits(limits);
    let mut decoder = reader.into_decoder().map_err(fail)?;
    let (width, height) = decoder.dimensions();
    TooLarge::check(
        width,
        height,
        u64::from(decoder.color_type().bytes_per_pixel()),
        limit_bytes,
    )?;
    let orientation = orientation(&mut decoder).map_err(fail)?;
    let decoded = DynamicImage::from_decoder(decoder).map_err(fail)?;
    Ok(upright(decoded, orientation))
}

/// Returns the EXIF orientation. The `image` crate does not find it behind the prefix `Exif\0\0`, which belongs to JPEG and
/// which some programs write into WebP and PNG, too.
fn orientation(decoder: &mut impl ImageDecoder) -> image::ImageResult<Orientation> {
    let prefixed = decoder.exif_metadata()?.and_then(|exif| {
        let exif = exif.strip_prefix(b"Exif\0\0")?;
        Orientation::from_exif_chunk(exif)
    });
    prefixed.map_or_else(|| decoder.orientation(), Ok)
}

/// Applies an EXIF orientation. Returns the picture, and a note if it was turned.
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

//! Decoding of every format but JPEG, within a limit of memory.

use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use super::decoded::{DecodeError, TooLarge, damaged, format_name};

/// Most bytes of a PNG besides its pixels. A colour profile that unpacks to more is not read.
const MOST_PNG_EXTRAS: u64 = 32 << 20;

/// Returns a reader of a photo, within a limit of memory.
pub(super) fn reader(bytes: &[u8], format: ImageFormat, limit_bytes: u64) -> ImageReader<Cursor<&[u8]>> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::no_limits();
    limits.max_alloc = match format {
        ImageFormat::Png => Some(limit_bytes.min(MOST_PNG_EXTRAS)),
        _ => Some(limit_bytes),
    };
    reader.limits(limits);
    reader
}

/// Decodes a photo other than a JPEG with the `image` crate, within a limit of memory.
pub(super) fn decode(
    bytes: &[u8],
    format: ImageFormat,
    limit_bytes: u64,
) -> Result<(DynamicImage, Vec<String>), DecodeError> {
    let name = format_name(format).unwrap_or("image");
    let fail = |error: image::ImageError| damaged(name, &error);
    let mut decoder = reader(bytes, format, limit_bytes).into_decoder().map_err(fail)?;
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A PNG of one pixel with a profile of zeros.
    fn with_profile(profile_bytes: usize) -> Vec<u8> {
        let mut info = png::Info::with_size(1, 1);
        info.icc_profile = Some(vec![0; profile_bytes].into());
        let mut bytes = Vec::new();
        let encoder = png::Encoder::with_info(&mut bytes, info).unwrap();
        encoder.write_header().unwrap().write_image_data(&[7]).unwrap();
        bytes
    }

    #[test]
    fn a_profile_that_unpacks_to_more_than_the_limit_is_not_read_and_the_photo_is() {
        for (profile_bytes, is_read) in [(1 << 10, true), (33 << 20, false)] {
            let bytes = with_profile(profile_bytes);
            let mut decoder = reader(&bytes, ImageFormat::Png, u64::MAX).into_decoder().unwrap();
            let profile = decoder.icc_profile().unwrap();
            assert_eq!(profile.is_some(), is_read, "{profile_bytes}");
            let (decoded, _) = decode(&bytes, ImageFormat::Png, 64 << 20).unwrap();
            assert_eq!(decoded.to_luma8().as_raw(), &[7], "{profile_bytes}");
        }
    }
}

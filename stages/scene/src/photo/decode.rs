use image::ImageFormat;

use super::decoded::{Alpha, DecodeError, MAX_DECODED_BYTES, Photo, format_name};
use super::{foreign, jpeg, other, tagged};

impl Photo {
    /// Decodes a JPEG, PNG, WebP, GIF, TIFF or PNM.
    ///
    /// Strict: a JPEG that is cut short or damaged is refused (the `image` crate alone fills the rest with grey). EXIF rotation is applied,
    /// 16 bits are reduced to 8, and alpha is blended over black. Of an animation the first frame is taken, of a TIFF the first page.
    /// [`Photo::notes`] says so. A TIFF may have strips or tiles. One with a separate plane for each colour is refused. At most
    /// [`MAX_DECODED_BYTES`] are decoded.
    ///
    /// # Errors
    /// See [`DecodeError`].
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        Self::decode_within(bytes, MAX_DECODED_BYTES)
    }

    /// As [`Photo::decode`], with a limit for the bytes of the decoded samples.
    ///
    /// # Errors
    /// See [`DecodeError`].
    pub fn decode_within(bytes: &[u8], limit_bytes: u64) -> Result<Self, DecodeError> {
        match guess(bytes) {
            None => Err(foreign::error(bytes)),
            Some(ImageFormat::Jpeg) => jpeg::decode(bytes, limit_bytes),
            Some(ImageFormat::Tiff) => tagged::decode(bytes, limit_bytes),
            Some(format) => {
                let (decoded, notes) = other::decode(bytes, format, limit_bytes)?;
                Ok(Self::from_upright(decoded, Alpha::Straight, notes))
            }
        }
    }

    /// Decodes bytes that [`Photo::decode`] has accepted before, to the same pixels in less time: it does not check
    /// the scan for damage again, and has no limit.
    ///
    /// # Errors
    /// As [`Photo::decode`].
    pub fn decode_validated(bytes: &[u8]) -> Result<Self, DecodeError> {
        match jpeg::decode_plain(bytes) {
            Some(photo) => Ok(photo),
            None => Self::decode_within(bytes, u64::MAX),
        }
    }

    /// Returns the name of the format of the bytes, whatever their file is called. `None` for a format that is not decoded.
    pub fn format(bytes: &[u8]) -> Option<&'static str> {
        guess(bytes).and_then(format_name)
    }

    /// Returns width and height in pixels from the header alone, before EXIF rotation. `None` without a known header.
    pub fn size_px(bytes: &[u8]) -> Option<(u32, u32)> {
        other::reader(bytes, guess(bytes)?, MAX_DECODED_BYTES)
            .into_dimensions()
            .ok()
    }
}

/// Returns the format of bytes by their start, or `None` if it is not decoded.
fn guess(bytes: &[u8]) -> Option<ImageFormat> {
    if tagged::BIG.iter().any(|start| bytes.starts_with(start)) {
        return Some(ImageFormat::Tiff);
    }
    let format = image::guess_format(bytes).ok()?;
    format_name(format).map(|_| format)
}

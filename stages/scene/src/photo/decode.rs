use std::io::Cursor;

use image::{ImageFormat, ImageReader};

use super::decoded::{DecodeError, Photo, format_name};
use super::{jpeg, other};

impl Photo {
    /// Decodes a JPEG, PNG, WebP, GIF, TIFF or PNM.
    ///
    /// Strict: a JPEG that is cut short or damaged is refused (the `image` crate alone fills the rest with grey). EXIF
    /// rotation is applied, 16 bits are reduced to 8, alpha is blended over black, of an animation the first
    /// frame is taken and of a TIFF the first page; [`Photo::notes`] says so. A TIFF may have strips or tiles; one whose colours lie in
    /// planes of their own is refused.
    ///
    /// # Errors
    /// See [`DecodeError`].
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        let format = image::guess_format(bytes)
            .ok()
            .filter(|format| format_name(*format).is_some());
        let Some(format) = format else {
            if bytes.is_empty() {
                return Err(DecodeError::Empty);
            }
            let start = bytes.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
            return Err(DecodeError::Format { start });
        };
        match format {
            ImageFormat::Jpeg => jpeg::decode(bytes),
            ImageFormat::Tiff => other::decode_tiff(bytes),
            _ => {
                let (decoded, notes) = other::decode(bytes, format)?;
                Ok(Self::from_upright(decoded, notes))
            }
        }
    }

    /// Decodes bytes that [`Photo::decode`] has accepted before, to the same pixels in less time: it does not check
    /// the scan for damage again.
    ///
    /// # Errors
    /// As [`Photo::decode`].
    pub fn decode_validated(bytes: &[u8]) -> Result<Self, DecodeError> {
        match jpeg::decode_plain(bytes).filter(|_| jpeg::has_end(bytes)) {
            Some(photo) => Ok(photo),
            None => Self::decode(bytes),
        }
    }

    /// Returns the name of the format of the bytes, whatever their file is called; `None` of one that is not decoded.
    pub fn format(bytes: &[u8]) -> Option<&'static str> {
        image::guess_format(bytes).ok().and_then(format_name)
    }

    /// Returns width and height in pixels from the header alone, before EXIF rotation; `None` without a known header.
    pub fn size_px(bytes: &[u8]) -> Option<(u32, u32)> {
        ImageReader::new(Cursor::new(bytes))
            .with_guessed_format()
            .ok()?
            .into_dimensions()
            .ok()
    }
}

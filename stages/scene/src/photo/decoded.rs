//! A decoded photo, and its encoding as PNG.

use image::{DynamicImage, ImageFormat};

use crate::image::box_means;
use crate::{Image, Srgb};

/// Bytes that the decoded samples of one photo may take unless another limit is given: 333 megapixels of 8-bit colour.
pub const MAX_DECODED_BYTES: u64 = 1_000_000_000;

/// The note of a photo of 16 bits.
pub(super) const SIXTEEN_BITS_REDUCED: &str = "16 bits reduced to 8";

/// A decoded photo: upright, three channels over black.
#[derive(Debug, Clone, PartialEq)]
pub struct Photo {
    /// The pixels, blended over black. One band is repeated three times.
    pub image: Image<Srgb>,
    /// Opacity of the pixels, `[height * width]`, 255 is opaque. Empty if all pixels are opaque.
    pub alpha: Vec<u8>,
    /// Bands stored in the file: 1 or 3 (alpha is blended over black and not counted).
    pub bands: u8,
    /// What was changed in decoding (`turned upright from EXIF orientation 6`), for the report.
    pub notes: Vec<String>,
}

/// Bytes that cannot be decoded as a photo.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The bytes are not a picture of a known format.
    #[error("not a JPEG, PNG, WebP, GIF, TIFF or PNM (starts with {start})")]
    Format {
        /// The first bytes, in hexadecimal.
        start: String,
    },
    /// The file ends too early or is damaged.
    #[error("{format}: {message}")]
    Damaged {
        /// Name of the format.
        format: &'static str,
        /// Message of the decoder, in one line.
        message: String,
    },
    /// No bytes at all.
    #[error("an empty file")]
    Empty,
    /// A format that is known and not read.
    #[error("{0} is not read: save it as JPEG, PNG or TIFF")]
    Foreign(&'static str),
    /// The header asks for more memory than the limit.
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
}

/// A photo whose decoded samples take more memory than the limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "{width} x {height} pixels take {} MB in memory, above the limit of {} MB",
    needed_bytes.div_ceil(1_000_000),
    limit_bytes / 1_000_000
)]
pub struct TooLarge {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes of the decoded samples.
    pub needed_bytes: u64,
    /// Most bytes that are allowed.
    pub limit_bytes: u64,
}

impl TooLarge {
    /// Checks that the samples of a photo, at `pixel_bytes` a pixel, fit in a limit.
    ///
    /// # Errors
    /// The size and the limit if they do not.
    pub fn check(width: u32, height: u32, pixel_bytes: u64, limit_bytes: u64) -> Result<(), Self> {
        let needed_bytes = (u64::from(width) * u64::from(height)).saturating_mul(pixel_bytes);
        if needed_bytes <= limit_bytes {
            return Ok(());
        }
        Err(Self {
            width,
            height,
            needed_bytes,
            limit_bytes,
        })
    }
}

/// How colours of a file relate to their opacity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Alpha {
    /// Not yet blended.
    Straight,
    /// Blended over black already.
    Premultiplied,
}

/// An opaque photo of three bands, as a PNG of the pixels decodes.
impl From<Image<Srgb>> for Photo {
    fn from(image: Image<Srgb>) -> Self {
        Self {
            image,
            alpha: Vec::new(),
            bands: 3,
            notes: Vec::new(),
        }
    }
}

impl Photo {
    /// Returns the photo of a picture that is upright, with the notes of its decoding so far.
    pub(super) fn from_upright(decoded: DynamicImage, alpha: Alpha, mut notes: Vec<String>) -> Self {
        if decoded.color().has_alpha() {
            notes.push(match alpha {
                Alpha::Straight => "alpha blended over black".to_owned(),
                Alpha::Premultiplied => "alpha is blended over black in the file".to_owned(),
            });
        }
        match decoded.color().bytes_per_pixel() / decoded.color().channel_count() {
            0 | 1 => {}
            2 => notes.push(SIXTEEN_BITS_REDUCED.to_owned()),
            _ => notes.push("numbers from 0 to 1 reduced to 8 bits".to_owned()),
        }
        let bands = if decoded.color().has_color() { 3 } else { 1 };
        let (image, alpha) = over_black(decoded, alpha);
        Self {
            image,
            alpha,
            bands,
            notes,
        }
    }

    /// Returns the photo of the pixels of a decoder, or `None` if they are too few or too many.
    pub(super) fn from_pixels(width: u32, height: u32, pixels: Vec<u8>) -> Option<Self> {
        let image = Image {
            width,
            height,
            pixels: in_threes(pixels),
        };
        let is_whole = image.pixels.len() as u64 == u64::from(width) * u64::from(height);
        is_whole.then(|| image.into())
    }

    /// Returns the photo reduced by an integer factor, as [`Image::box_reduced`].
    pub fn box_reduced(&self, factor: u32) -> Self {
        Self {
            image: self.image.box_reduced(factor),
            alpha: alpha_reduced(&self.alpha, self.image.width, factor),
            bands: self.bands,
            notes: self.notes.clone(),
        }
    }

    /// Encodes the photo as PNG, which decodes to the same pixels and opacities. Equal photos give equal bytes.
    ///
    /// # Errors
    /// As [`encode_png`].
    pub fn to_png(&self) -> Result<Vec<u8>, DecodeError> {
        if self.alpha.is_empty() {
            return encode_png(&self.image);
        }
        // What was blended over black and rounded is at most its opacity, so that the quotient is at most 255.
        let straight = |channel: u8, alpha: u8| match u32::from(alpha) {
            0 => 0,
            alpha => ((u32::from(channel) * 255 + alpha / 2) / alpha).min(255) as u8,
        };
        let pixels = self.image.pixels.iter().zip(&self.alpha);
        let pixels = pixels.map(|([r, g, b], alpha)| {
            [
                straight(*r, *alpha),
                straight(*g, *alpha),
                straight(*b, *alpha),
                *alpha,
            ]
        });
        let pixels: Vec<[u8; 4]> = pixels.collect();
        png_of(
            pixels.as_flattened(),
            [self.image.width, self.image.height],
            image::ExtendedColorType::Rgba8,
        )
    }
}

/// Encodes an image as PNG. Equal images give equal bytes.
///
/// # Errors
/// An image of zero pixels.
pub fn encode_png(image: &Image<Srgb>) -> Result<Vec<u8>, DecodeError> {
    png_of(
        image.pixels.as_flattened(),
        [image.width, image.height],
        image::ExtendedColorType::Rgb8,
    )
}

fn png_of(
    pixels: &[u8],
    [width, height]: [u32; 2],
    color: image::ExtendedColorType,
) -> Result<Vec<u8>, DecodeError> {
    let mut bytes = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    image::ImageEncoder::write_image(encoder, pixels, width, height, color)
        .map_err(|error| damaged("PNG", &error))?;
    Ok(bytes)
}

/// Returns the name of a format that is decoded, or `None` for all others.
pub(super) fn format_name(format: ImageFormat) -> Option<&'static str> {
    match format {
        ImageFormat::Jpeg => Some("JPEG"),
        ImageFormat::Png => Some("PNG"),
        ImageFormat::WebP => Some("WebP"),
        ImageFormat::Gif => Some("GIF"),
        ImageFormat::Tiff => Some("TIFF"),
        ImageFormat::Pnm => Some("PNM"),
        _ => None,
    }
}

/// Returns the error of a decoder, in one line.
pub(crate) fn damaged(format: &'static str, error: &dyn std::fmt::Display) -> DecodeError {
    // Messages of decoders have line breaks.
    let message = error.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    DecodeError::Damaged { format, message }
}

/// Returns bytes as pixels, without a copy where none of their memory is unused.
fn in_threes(bytes: Vec<u8>) -> Vec<[u8; 3]> {
    let pixels = bytemuck::allocation::try_cast_vec(bytes);
    pixels.unwrap_or_else(|(_, bytes)| bytes.as_chunks().0.to_vec())
}

/// Returns the pixels blended over black, and their alpha unless all are opaque. 8-bit colour without alpha is neither copied nor
/// converted.
fn over_black(decoded: DynamicImage, stored: Alpha) -> (Image<Srgb>, Vec<u8>) {
    let (width, height) = (decoded.width(), decoded.height());
    let (pixels, alpha) = if decoded.color().has_alpha() {
        let blend = |channel: u8, alpha: u8| match stored {
            Alpha::Straight => ((u16::from(channel) * u16::from(alpha) + 127) / 255) as u8,
            // No colour can be brighter than its opacity.
            Alpha::Premultiplied => channel.min(alpha),
        };
        let pixels = decoded.into_rgba8();
        let over_black = |rgba: &image::Rgba<u8>| {
            let [r, g, b, alpha] = rgba.0;
            ([r, g, b].map(|channel| blend(channel, alpha)), alpha)
        };
        pixels.pixels().map(over_black).unzip()
    } else {
        (in_threes(decoded.into_rgb8().into_raw()), Vec::new())
    };
    let is_opaque = alpha.iter().all(|alpha| *alpha == 255);
    let image = Image {
        width,
        height,
        pixels,
    };
    (image, if is_opaque { Vec::new() } else { alpha })
}

/// Returns opacities, `[height * width]` or none, reduced as [`Image::box_reduced`] reduces colours.
fn alpha_reduced(alpha: &[u8], width: u32, factor: u32) -> Vec<u8> {
    box_means(alpha.as_chunks::<1>().0, width, factor)
        .as_flattened()
        .to_vec()
}

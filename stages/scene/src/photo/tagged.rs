//! Decoding of TIFFs: the tones by the file's own tags.

use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, GrayAlphaImage, GrayImage, ImageBuffer, ImageFormat, RgbImage, RgbaImage};
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;
use tiff::{ColorType, TiffError};

use super::decoded::{Alpha, DecodeError, Photo, SIXTEEN_BITS_REDUCED, TooLarge, damaged};
use super::other;
use super::strips::{self, Tiff};
use super::tones::Tones;

/// First bytes of a BigTIFF, in both byte orders.
pub(super) const BIG: [&[u8]; 2] = [b"II+\0", b"MM\0+"];
/// PlanarConfiguration of a TIFF whose pixels have their channels side by side.
const CHUNKY: u16 = 1;

/// Decodes the first page of a TIFF.
///
/// Separate planes are refused before they are decoded: `image` 0.25.10 panics on some that have 16 bits.
pub(super) fn decode(bytes: &[u8], limit_bytes: u64) -> Result<Photo, DecodeError> {
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(fail)?;
    let planes = decoder
        .find_tag_unsigned::<u16>(Tag::PlanarConfiguration)
        .map_err(fail)?;
    if planes.is_some_and(|planes| planes != CHUNKY) {
        let message = "its colours are in separate planes (PlanarConfiguration 2), which are not read: save it with pixels in one plane";
        return Err(damaged("TIFF", &message));
    }
    let pages = decoder
        .more_images()
        .then(|| "the first of several pages".to_owned());
    let (stored, alpha) = stored(&mut decoder).map_err(fail)?;
    let Page {
        decoded,
        mut notes,
        is_reduced,
    } = match stored {
        // Bits, inks and colours from a palette: as the `image` crate reads them.
        Stored::Other => {
            let (decoded, notes) = other::decode(bytes, ImageFormat::Tiff, limit_bytes)?;
            Page {
                decoded,
                notes,
                is_reduced: false,
            }
        }
        _ => page(decoder, stored, limit_bytes)?,
    };
    notes.extend(pages);
    notes.extend(is_reduced.then(|| SIXTEEN_BITS_REDUCED.to_owned()));
    Ok(Photo::from_upright(decoded, alpha, notes))
}

fn fail(error: TiffError) -> DecodeError {
    let way_out = "save it as gray or RGB of 8 or 16 bits, uncompressed or with LZW, Deflate or JPEG";
    match &error {
        TiffError::UnsupportedError(what) => damaged("TIFF", &format!("{what}: {way_out}")),
        _ => damaged("TIFF", &error),
    }
}

/// The samples of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stored {
    /// One, and further ones other than opacity.
    Gray {
        samples: usize,
    },
    /// One and its opacity, and further ones.
    GrayAlpha {
        samples: usize,
    },
    Rgb,
    Rgba,
    YCbCr,
    /// Any other.
    Other,
}

impl Stored {
    fn samples(self) -> usize {
        match self {
            Self::Gray { samples } | Self::GrayAlpha { samples } => samples,
            Self::Rgba => 4,
            Self::Rgb | Self::YCbCr | Self::Other => 3,
        }
    }
}

/// Returns the samples of a pixel, and how colours relate to opacity by the tag ExtraSamples.
fn stored(decoder: &mut Tiff<'_>) -> Result<(Stored, Alpha), TiffError> {
    let extra = decoder.find_tag_unsigned_vec::<u16>(Tag::ExtraSamples)?;
    let extra = extra.as_ref().and_then(|extra| extra.first()).copied();
    let alpha = match extra {
        Some(1) => Alpha::Premultiplied,
        _ => Alpha::Straight,
    };
    let stored = match decoder.colortype()? {
        ColorType::Gray(8 | 16 | 32 | 64) => Stored::Gray { samples: 1 },
        ColorType::Multiband {
            bit_depth: 8 | 16 | 32 | 64,
            num_samples,
        } => {
            let samples = usize::from(num_samples);
            match extra {
                Some(1 | 2) => Stored::GrayAlpha { samples },
                _ => Stored::Gray { samples },
            }
        }
        ColorType::RGB(8 | 16 | 32 | 64) => Stored::Rgb,
        ColorType::RGBA(8 | 16 | 32 | 64) => Stored::Rgba,
        ColorType::YCbCr(8) => Stored::YCbCr,
        _ => Stored::Other,
    };
    Ok((stored, alpha))
}

/// A page, turned upright.
struct Page {
    decoded: DynamicImage,
    /// On its tones.
    notes: Vec<String>,
    /// It was read as 8 bits of the whole range of 16 bits.
    is_reduced: bool,
}

/// Decodes a page of gray or colour.
fn page(decoder: Tiff<'_>, stored: Stored, limit_bytes: u64) -> Result<Page, DecodeError> {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = usize::try_from(limit_bytes).unwrap_or(usize::MAX);
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    let mut decoder = decoder.with_limits(limits);
    let (width, height) = decoder.dimensions().map_err(fail)?;
    let bits = decoder
        .find_tag_unsigned_vec::<u16>(Tag::BitsPerSample)
        .map_err(fail)?;
    let sample_bytes = bits
        .and_then(|bits| bits.first().copied())
        .unwrap_or(8)
        .div_ceil(8);
    let pixel_bytes = u64::from(sample_bytes) * stored.samples() as u64;
    TooLarge::check(width, height, pixel_bytes, limit_bytes)?;
    let tones = Tones::from_tags(&mut decoder).map_err(fail)?;
    let orientation = decoder
        .find_tag_unsigned::<u8>(Tag::Orientation)
        .map_err(fail)?
        .and_then(Orientation::from_exif)
        .unwrap_or(Orientation::NoTransforms);
    let mut notes = Vec::new();
    let is_plain = matches!(stored, Stored::Rgb | Stored::Gray { samples: 1 });
    let in_strips = if sample_bytes == 2 && is_plain {
        strips::read(&mut decoder, &tones, &mut notes).map_err(fail)?
    } else {
        None
    };
    let is_reduced = in_strips.is_some() && tones.white_of_16_bits() == f64::from(u16::MAX);
    let samples = match in_strips {
        Some(samples) => DecodingResult::U8(samples),
        None => tones.displayed(decoder.read_image().map_err(fail)?, &mut notes),
    };
    let decoded = image(samples, stored, width, height);
    let decoded = decoded.ok_or_else(|| damaged("TIFF", &"fewer pixels than its header says"))?;
    let (decoded, turned) = other::upright(decoded, orientation);
    notes.extend(turned);
    Ok(Page {
        decoded,
        notes,
        is_reduced,
    })
}

/// Returns the picture of samples of 8 or 16 bits, or `None` if they are too few.
fn image(samples: DecodingResult, stored: Stored, width: u32, height: u32) -> Option<DynamicImage> {
    match samples {
        DecodingResult::U8(samples) => {
            let samples = first_samples(samples, stored);
            Some(match stored {
                Stored::Gray { .. } => GrayImage::from_raw(width, height, samples)?.into(),
                Stored::GrayAlpha { .. } => GrayAlphaImage::from_raw(width, height, samples)?.into(),
                Stored::Rgba => RgbaImage::from_raw(width, height, samples)?.into(),
                Stored::YCbCr => RgbImage::from_raw(width, height, to_rgb(samples))?.into(),
                Stored::Rgb | Stored::Other => RgbImage::from_raw(width, height, samples)?.into(),
            })
        }
        DecodingResult::U16(samples) => {
            let samples = first_samples(samples, stored);
            Some(match stored {
                Stored::Gray { .. } => {
                    DynamicImage::ImageLuma16(ImageBuffer::from_raw(width, height, samples)?)
                }
                Stored::GrayAlpha { .. } => {
                    DynamicImage::ImageLumaA16(ImageBuffer::from_raw(width, height, samples)?)
                }
                Stored::Rgba => DynamicImage::ImageRgba16(ImageBuffer::from_raw(width, height, samples)?),
                _ => DynamicImage::ImageRgb16(ImageBuffer::from_raw(width, height, samples)?),
            })
        }
        _ => None,
    }
}

/// Leaves the samples of each pixel that are gray and opacity.
fn first_samples<T: Copy>(samples: Vec<T>, stored: Stored) -> Vec<T> {
    let (all, used) = match stored {
        Stored::Gray { samples } => (samples, 1),
        Stored::GrayAlpha { samples } => (samples, 2),
        _ => return samples,
    };
    if all == used {
        return samples;
    }
    let pixels = samples.chunks_exact(all.max(1));
    pixels.flat_map(|pixel| &pixel[..used]).copied().collect()
}

/// Converts pixels of Y, Cb and Cr to RGB, as JPEGs store them (ITU-T T.871: all three in 0 to 255).
fn to_rgb(mut samples: Vec<u8>) -> Vec<u8> {
    for pixel in samples.as_chunks_mut::<3>().0 {
        let [y, cb, cr] = pixel.map(f32::from);
        let (cb, cr) = (cb - 128.0, cr - 128.0);
        let rgb = [
            y + 1.402 * cr,
            y - 0.344_136 * cb - 0.714_136 * cr,
            y + 1.772 * cb,
        ];
        *pixel = rgb.map(|channel| (channel + 0.5) as u8);
    }
    samples
}

#[cfg(test)]
mod tests;

//! Decoding of photos, and encoding as PNG.

use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, GrayImage, ImageDecoder, ImageFormat, ImageReader, Limits, RgbImage};
use tiff::tags::Tag;
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;
use zune_jpeg::errors::DecodeErrors;

use crate::image::box_means;
use crate::{Image, Srgb};

mod scan;

/// Largest width or height that is decoded, in pixels.
pub const MAX_SIDE: u32 = 20_000;
/// Most memory one decode may take, in bytes.
pub const MAX_DECODE_BYTES: u64 = 256 << 20;

/// A decoded photo: upright, three channels over black.
#[derive(Debug, Clone, PartialEq)]
pub struct Photo {
    /// The pixels, blended over black; one band is repeated three times.
    pub image: Image<Srgb>,
    /// Opacity of the pixels, `[height * width]`, 255: nothing shows through; empty where nothing shows through any.
    pub alpha: Vec<u8>,
    /// Bands stored in the file: 1 or 3 (alpha is blended over black and not counted).
    pub bands: u8,
    /// What was changed in decoding (`turned upright from EXIF orientation 6`), for the report.
    pub notes: Vec<String>,
}

/// Bytes that cannot be decoded as a photo.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The bytes are no picture of a known format.
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
    /// The header asks for more than the limits allow.
    #[error("{width} x {height} pixels, at most {MAX_SIDE} a side and {} MB are decoded", MAX_DECODE_BYTES >> 20)]
    TooLarge {
        /// Width asked for.
        width: u32,
        /// Height asked for.
        height: u32,
    },
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
            ImageFormat::Jpeg => decode_jpeg(bytes),
            ImageFormat::Tiff => decode_tiff(bytes),
            _ => Ok(Self::of_upright(decode_limited(bytes, format)?)),
        }
    }

    /// Returns the photo of a picture that is upright, with the notes of its decoding so far.
    fn of_upright((decoded, mut notes): (DynamicImage, Vec<String>)) -> Self {
        if decoded.color().has_alpha() {
            notes.push("alpha blended over black".to_owned());
        }
        match decoded.color().bytes_per_pixel() / decoded.color().channel_count() {
            0 | 1 => {}
            2 => notes.push("16 bits reduced to 8".to_owned()),
            _ => notes.push("numbers from 0 to 1 reduced to 8 bits".to_owned()),
        }
        let bands = if decoded.color().has_color() { 3 } else { 1 };
        let (image, alpha) = over_black(decoded);
        Self {
            image,
            alpha,
            bands,
            notes,
        }
    }

    /// Returns the photo of the pixels of a decoder; `None` if they are too few or too many.
    fn of_pixels(width: u32, height: u32, pixels: Vec<u8>) -> Option<Self> {
        let pixels = bytemuck::allocation::try_cast_vec(pixels);
        let pixels: Vec<[u8; 3]> = pixels.unwrap_or_else(|(_, bytes)| bytes.as_chunks().0.to_vec());
        let image = Image {
            width,
            height,
            pixels,
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

    /// Encodes the photo as PNG, which decodes to the same pixels and opacities; equal photos give equal bytes.
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

    /// Decodes bytes that [`Photo::decode`] has accepted before, to the same pixels in less time: it does not check
    /// the scan for damage again.
    ///
    /// # Errors
    /// As [`Photo::decode`].
    pub fn decode_validated(bytes: &[u8]) -> Result<Self, DecodeError> {
        match plain_jpeg(bytes).filter(|_| has_end(bytes)) {
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

/// Encodes an image as PNG; equal images give equal bytes.
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

/// Returns the name of a format that is decoded; `None` for all others.
fn format_name(format: ImageFormat) -> Option<&'static str> {
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

/// Decodes a JPEG strictly and requires its end marker: a file cut in half, or with a damaged scan, must not become
/// training data. (The `image` crate decodes with the same library, but leniently.)
fn decode_jpeg(bytes: &[u8]) -> Result<Photo, DecodeError> {
    let fail = |error: DecodeErrors| damaged("JPEG", &format!("{error:?}"));
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(MAX_SIDE as usize)
        .set_max_height(MAX_SIDE as usize);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(fail)?;
    if !has_end(bytes) {
        return Err(damaged(
            "JPEG",
            &"the end marker FF D9 is missing: the file is cut short",
        ));
    }
    let (width, height) = decoder.dimensions().unwrap_or_default();
    let (width, height) = (width as u32, height as u32);
    if u64::from(width) * u64::from(height) * 3 > MAX_DECODE_BYTES {
        return Err(DecodeError::TooLarge { width, height });
    }
    let grey = decoder.input_colorspace() == Some(ColorSpace::Luma);
    let kept = if grey { ColorSpace::Luma } else { ColorSpace::RGB };
    decoder.set_options(options.jpeg_set_out_colorspace(kept));
    scan::check(bytes).map_err(|error| damaged("JPEG", &error))?;
    let pixels = decoder.decode().map_err(fail)?;
    let orientation = decoder.exif().and_then(|exif| Orientation::from_exif_chunk(exif));
    let orientation = orientation.unwrap_or(Orientation::NoTransforms);
    let photo = if grey {
        let decoded = GrayImage::from_raw(width, height, pixels).map(DynamicImage::from);
        decoded.map(|decoded| Photo::of_upright(upright(decoded, orientation)))
    } else if orientation == Orientation::NoTransforms {
        Photo::of_pixels(width, height, pixels)
    } else {
        let decoded = RgbImage::from_raw(width, height, pixels).map(DynamicImage::from);
        decoded.map(|decoded| Photo::of_upright(upright(decoded, orientation)))
    };
    photo.ok_or_else(|| damaged("JPEG", &"fewer pixels than its header says"))
}

/// Applies an EXIF orientation; returns the picture, and a note if it was turned.
fn upright(mut decoded: DynamicImage, orientation: Orientation) -> (DynamicImage, Vec<String>) {
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

/// Returns whether a JPEG has its end marker within its last 4096 bytes.
fn has_end(bytes: &[u8]) -> bool {
    bytes.windows(2).rev().take(4096).any(|pair| pair == [0xff, 0xd9])
}

/// Decodes an upright JPEG of three channels straight into its pixels; `None` for anything else, errors included.
///
/// The same decoder as in [`decode_jpeg`], but without counting the units of the scan. Where it returns `None`, [`Photo::decode`] finds the error.
fn plain_jpeg(bytes: &[u8]) -> Option<Photo> {
    let options = DecoderOptions::default()
        .set_strict_mode(false)
        .set_max_width(MAX_SIDE as usize)
        .set_max_height(MAX_SIDE as usize)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().ok()?;
    let (width, height) = decoder.dimensions()?;
    let colour = matches!(decoder.input_colorspace()?, ColorSpace::YCbCr | ColorSpace::RGB);
    let turned = decoder
        .exif()
        .and_then(|exif| Orientation::from_exif_chunk(exif))
        .is_some_and(|orientation| orientation.to_exif() != 1);
    if !colour || turned || (3 * width * height) as u64 > MAX_DECODE_BYTES {
        return None;
    }
    Photo::of_pixels(width as u32, height as u32, decoder.decode().ok()?)
}

/// Decodes a photo other than a JPEG with the `image` crate, within the limits of size and memory.
fn decode_limited(bytes: &[u8], format: ImageFormat) -> Result<(DynamicImage, Vec<String>), DecodeError> {
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
fn decode_tiff(bytes: &[u8]) -> Result<Photo, DecodeError> {
    let fail = |error: tiff::TiffError| damaged("TIFF", &error);
    let mut decoder = tiff::decoder::Decoder::new(Cursor::new(bytes)).map_err(fail)?;
    let planes = decoder
        .find_tag_unsigned::<u16>(Tag::PlanarConfiguration)
        .map_err(fail)?;
    if planes.is_some_and(|planes| planes != CHUNKY) {
        let message = "its colours lie in planes of their own (PlanarConfiguration 2), which are not read: save it with pixels in one plane";
        return Err(damaged("TIFF", &message));
    }
    let (decoded, mut notes) = decode_limited(bytes, ImageFormat::Tiff)?;
    if decoder.more_images() {
        notes.push("the first of several pages".to_owned());
    }
    Ok(Photo::of_upright((decoded, notes)))
}

/// PlanarConfiguration of a TIFF whose pixels have their channels side by side.
const CHUNKY: u16 = 1;

/// Returns the pixels blended over black, and their alpha unless all are opaque; 8-bit colour without alpha is copied once and not
/// converted.
fn over_black(decoded: DynamicImage) -> (Image<Srgb>, Vec<u8>) {
    let (width, height) = (decoded.width(), decoded.height());
    let (pixels, alpha) = if decoded.color().has_alpha() {
        let blend = |channel: u8, alpha: u8| ((u16::from(channel) * u16::from(alpha) + 127) / 255) as u8;
        let pixels = decoded.into_rgba8();
        let over_black = |rgba: &image::Rgba<u8>| {
            let [r, g, b, alpha] = rgba.0;
            ([r, g, b].map(|channel| blend(channel, alpha)), alpha)
        };
        pixels.pixels().map(over_black).unzip()
    } else {
        (decoded.into_rgb8().into_raw().as_chunks().0.to_vec(), Vec::new())
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
pub fn alpha_reduced(alpha: &[u8], width: u32, factor: u32) -> Vec<u8> {
    box_means(alpha.as_chunks::<1>().0, width, factor)
        .as_flattened()
        .to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient() -> Image<Srgb> {
        Image::from_fn(40, 30, |x, y| [(x * 6) as u8, (y * 8) as u8, 77])
    }

    #[test]
    fn a_png_survives() {
        let photo = Photo::decode(&encode_png(&gradient()).unwrap()).unwrap();
        assert_eq!(photo.image, gradient());
        assert_eq!(photo.bands, 3);
    }

    #[test]
    fn transparency_survives_a_png_and_is_reduced_with_its_pixels() {
        // Every colour at every opacity.
        let rgba =
            image::RgbaImage::from_fn(256, 256, |x, y| image::Rgba([x as u8, 255 - x as u8, 7, y as u8]));
        let mut bytes = Cursor::new(Vec::new());
        rgba.write_to(&mut bytes, ImageFormat::Png).unwrap();
        let photo = Photo::decode(bytes.get_ref()).unwrap();
        assert_eq!(
            (photo.alpha[0], photo.alpha[256], photo.image.at(200, 51)[0]),
            (0, 1, 40)
        );
        let again = Photo::decode(&photo.to_png().unwrap()).unwrap();
        assert_eq!((&again.image, &again.alpha), (&photo.image, &photo.alpha));
        let small = photo.box_reduced(4);
        assert_eq!((small.image.width, small.alpha.len()), (64, 64 * 64));
        // Of rows 0 to 3: 1.5, rounded half up.
        assert_eq!(small.alpha[..64], [2; 64]);
    }

    #[test]
    fn a_photo_whose_alpha_hides_nothing_is_opaque() {
        let rgba = image::RgbaImage::from_pixel(3, 2, image::Rgba([9, 8, 7, 255]));
        let mut bytes = Cursor::new(Vec::new());
        rgba.write_to(&mut bytes, ImageFormat::Png).unwrap();
        let photo = Photo::decode(bytes.get_ref()).unwrap();
        assert!(photo.alpha.is_empty() && photo.box_reduced(2).alpha.is_empty());
        assert_eq!(photo.to_png(), encode_png(&photo.image));
    }

    fn jpeg(pixels: &[u8], color: image::ExtendedColorType) -> Vec<u8> {
        let mut bytes = Vec::new();
        let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 90);
        image::ImageEncoder::write_image(encoder, pixels, 40, 30, color).unwrap();
        bytes
    }

    /// [`plain_jpeg`] gives the same pixels as the strict decoder, and refuses everything else.
    #[test]
    fn a_plain_jpeg_has_the_same_pixels_both_ways() {
        let bytes = jpeg(gradient().pixels.as_flattened(), image::ExtendedColorType::Rgb8);
        assert_eq!(plain_jpeg(&bytes), Some(Photo::decode(&bytes).unwrap()));
        let gray = jpeg(&[90; 40 * 30], image::ExtendedColorType::L8);
        assert_eq!(plain_jpeg(&gray), None);
        assert_eq!(Photo::decode(&gray).unwrap().bands, 1);
        assert_eq!(plain_jpeg(&bytes[..40]), None);
        for bytes in [bytes, gray, encode_png(&gradient()).unwrap()] {
            assert_eq!(Photo::decode_validated(&bytes), Photo::decode(&bytes));
            assert!(Photo::decode_validated(&bytes[..bytes.len() / 2]).is_err());
        }
    }

    #[test]
    fn a_jpeg_cut_anywhere_is_refused() {
        let bytes = jpeg(gradient().pixels.as_flattened(), image::ExtendedColorType::Rgb8);
        assert!(Photo::decode(&bytes).is_ok());
        for cut in 2..bytes.len() - 2 {
            for end in [&[][..], &[0xff, 0xd9]] {
                let error = Photo::decode(&[&bytes[..cut], end].concat()).unwrap_err();
                assert!(
                    matches!(error, DecodeError::Damaged { .. } | DecodeError::Format { .. }),
                    "{cut}: {error}"
                );
            }
        }
    }

    #[test]
    fn no_image_is_named_by_its_first_bytes() {
        let error = Photo::decode(b"<html>").unwrap_err();
        assert_eq!(
            error.to_string(),
            "not a JPEG, PNG, WebP, GIF, TIFF or PNM (starts with 3c68746d6c3e)"
        );
        assert_eq!(Photo::decode(b"").unwrap_err().to_string(), "an empty file");
    }

    #[test]
    fn an_error_is_one_line() {
        let error = Photo::decode(b"\xff\xd8\xff\xe0").unwrap_err().to_string();
        assert!(!error.contains('\n') && !error.ends_with(' '), "{error:?}");
    }

    /// A little-endian TIFF: short values by tag, then strips or tiles, whose offsets and lengths stand in `offsets` and `lengths`.
    fn tiff_of(shorts: &[(u16, &[u16])], [offsets, lengths]: [u16; 2], parts: &[Vec<u8>]) -> Vec<u8> {
        let mut tags: Vec<(u16, u16, Vec<u8>)> = shorts
            .iter()
            .map(|(tag, values)| {
                (
                    *tag,
                    3,
                    values.iter().flat_map(|value| value.to_le_bytes()).collect(),
                )
            })
            .collect();
        let longs =
            |of: &dyn Fn(usize) -> u32| (0..parts.len()).flat_map(|part| of(part).to_le_bytes()).collect();
        tags.push((lengths, 4, longs(&|part| parts[part].len() as u32)));
        tags.push((offsets, 4, vec![0; 4 * parts.len()]));
        tags.sort();
        let mut rest = 8 + 2 + 12 * tags.len() + 4;
        let mut places = Vec::new();
        for (_, _, value) in &tags {
            places.push(rest);
            rest += if value.len() > 4 { value.len() } else { 0 };
        }
        let starts: Vec<usize> = parts
            .iter()
            .scan(rest, |at, part| {
                let start = *at;
                *at += part.len();
                Some(start)
            })
            .collect();
        let own = tags.iter_mut().find(|(tag, ..)| *tag == offsets).unwrap();
        own.2 = longs(&|part| starts[part] as u32);
        let mut bytes = [
            b"II*\0".as_slice(),
            &8_u32.to_le_bytes(),
            &(tags.len() as u16).to_le_bytes(),
        ]
        .concat();
        for ((tag, kind, value), place) in tags.iter().zip(&places) {
            let count = value.len() / if *kind == 3 { 2 } else { 4 };
            let mut inline = value.clone();
            inline.resize(4, 0);
            let field = if value.len() > 4 {
                (*place as u32).to_le_bytes().to_vec()
            } else {
                inline
            };
            bytes.extend(
                [
                    &tag.to_le_bytes()[..],
                    &kind.to_le_bytes(),
                    &(count as u32).to_le_bytes(),
                    &field,
                ]
                .concat(),
            );
        }
        bytes.extend([0; 4]);
        bytes.extend(
            tags.iter()
                .filter(|(_, _, value)| value.len() > 4)
                .flat_map(|(_, _, value)| value.clone()),
        );
        bytes.extend(parts.concat());
        bytes
    }

    fn written(color: image::ExtendedColorType, pixels: &[u8], format: ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image::write_buffer_with_format(&mut bytes, pixels, 40, 30, color, format).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn tiff_and_pnm_are_read_with_8_and_16_bits() {
        let expected = gradient();
        let eight = expected.pixels.as_flattened();
        // 257 times a value of 8 bits is the same light in 16.
        let sixteen: Vec<u8> = eight
            .iter()
            .flat_map(|value| (u16::from(*value) * 257).to_ne_bytes())
            .collect();
        for format in [ImageFormat::Tiff, ImageFormat::Pnm] {
            let photo = Photo::decode(&written(image::ExtendedColorType::Rgb8, eight, format)).unwrap();
            assert_eq!((photo.image, photo.bands), (expected.clone(), 3), "{format:?}");
            assert_eq!(photo.notes, [""; 0], "{format:?}");
            let gray = Photo::decode(&written(image::ExtendedColorType::L8, &eight[..1200], format)).unwrap();
            assert_eq!(
                (gray.image.at(1, 0), gray.bands),
                ([eight[1]; 3], 1),
                "{format:?}"
            );
        }
        let deep = Photo::decode(&written(
            image::ExtendedColorType::Rgb16,
            &sixteen,
            ImageFormat::Tiff,
        ))
        .unwrap();
        assert_eq!(
            (deep.image, deep.notes),
            (expected.clone(), vec!["16 bits reduced to 8".to_owned()])
        );
        let head = b"P6\n40 30\n65535\n".to_vec();
        let big_endian = eight
            .iter()
            .flat_map(|value| (u16::from(*value) * 257).to_be_bytes());
        let deep = Photo::decode(&head.into_iter().chain(big_endian).collect::<Vec<_>>()).unwrap();
        assert_eq!(deep.image, expected);
        assert_eq!(Photo::format(b"P5\n1 1\n255\n\0"), Some("PNM"));
        assert_eq!(Photo::format(b"<html>"), None);
    }

    /// 10 x 12 gray pixels in a tile of 16 x 16; and 2 x 2 pixels of 16 bits with a plane for each of three colours.
    #[test]
    fn a_tiff_of_tiles_is_read_and_one_of_planes_is_refused_in_words() {
        let tile: Vec<u8> = (0..=255).collect();
        let tiled = tiff_of(
            &[
                (256, &[10]),
                (257, &[12]),
                (258, &[8]),
                (259, &[1]),
                (262, &[1]),
                (277, &[1]),
                (322, &[16]),
                (323, &[16]),
            ],
            [324, 325],
            &[tile],
        );
        let photo = Photo::decode(&tiled).unwrap();
        assert_eq!((photo.image.width, photo.image.height), (10, 12));
        assert_eq!((photo.image.at(0, 0), photo.image.at(9, 11)), ([0; 3], [185; 3]));
        let planes = tiff_of(
            &[
                (256, &[2]),
                (257, &[2]),
                (258, &[16, 16, 16]),
                (259, &[1]),
                (262, &[2]),
                (277, &[3]),
                (278, &[2]),
                (284, &[2]),
            ],
            [273, 279],
            &[vec![1; 8], vec![2; 8], vec![3; 8]],
        );
        let error = Photo::decode(&planes).unwrap_err().to_string();
        assert!(error.contains("planes of their own"), "{error}");
    }

    #[test]
    fn a_tiff_that_asks_for_more_than_the_limits_is_refused_before_it_is_decoded() {
        for side in [20_001, 65_535] {
            let bomb = tiff_of(
                &[
                    (256, &[side]),
                    (257, &[side]),
                    (258, &[8]),
                    (259, &[1]),
                    (262, &[1]),
                    (277, &[1]),
                    (278, &[side]),
                ],
                [273, 279],
                &[vec![0; 16]],
            );
            assert!(Photo::decode(&bomb).is_err(), "{side}");
        }
        assert!(Photo::decode(b"P5\n65535 65535\n255\n").is_err());
        assert!(Photo::decode(b"P5\n4 4\n255\n\x01\x02").is_err(), "cut short");
    }

    /// A file whose bytes were changed is decoded or refused: it never panics, and never takes long.
    #[test]
    fn damaged_tiffs_are_decoded_or_refused() {
        let whole = written(
            image::ExtendedColorType::Rgb8,
            gradient().pixels.as_flattened(),
            ImageFormat::Tiff,
        );
        for cut in (0..whole.len()).step_by(7) {
            let _ = Photo::decode(&whole[..cut]);
        }
        // The directory stands at the end: its bytes decide everything.
        let directory = whole.len().saturating_sub(400);
        for at in (0..8).chain(directory..whole.len()) {
            for value in [0, 1, 2, 3, 4, 5, 7, 16, 32, 127, 128, 255] {
                let mut damaged = whole.clone();
                damaged[at] = value;
                let _ = Photo::decode(&damaged);
            }
        }
    }
}

use std::io::Cursor;

use image::ImageFormat;

use super::*;
use crate::{Image, Srgb};

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
    let rgba = image::RgbaImage::from_fn(256, 256, |x, y| image::Rgba([x as u8, 255 - x as u8, 7, y as u8]));
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

/// [`jpeg::decode_plain`] gives the same pixels as the strict decoder, and refuses everything else.
#[test]
fn a_plain_jpeg_has_the_same_pixels_both_ways() {
    let bytes = jpeg(gradient().pixels.as_flattened(), image::ExtendedColorType::Rgb8);
    assert_eq!(jpeg::decode_plain(&bytes), Some(Photo::decode(&bytes).unwrap()));
    let gray = jpeg(&[90; 40 * 30], image::ExtendedColorType::L8);
    assert_eq!(jpeg::decode_plain(&gray), None);
    assert_eq!(Photo::decode(&gray).unwrap().bands, 1);
    assert_eq!(jpeg::decode_plain(&bytes[..40]), None);
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

/// A little-endian TIFF: short values by tag, then strips or tiles, with offsets and lengths in `offsets` and `lengths`.
pub(super) fn tiff_of(shorts: &[(u16, &[u16])], [offsets, lengths]: [u16; 2], parts: &[Vec<u8>]) -> Vec<u8> {
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

/// 10 x 12 gray pixels in a tile of 16 x 16, and 2 x 2 pixels of 16 bits with a plane for each of three colours.
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
    assert!(
        error.contains("its colours are in separate planes (PlanarConfiguration 2), which are not read: save it with pixels in one plane"),
        "{error}"
    );
}

#[test]
fn a_tiff_that_asks_for_more_than_the_limit_is_refused_before_it_is_decoded() {
    for (side, limit_mb, needed_mb) in [(20_001, 400, 401), (65_535, 1_000, 4_295)] {
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
        let error = Photo::decode_within(&bomb, limit_mb * 1_000_000).unwrap_err();
        assert_eq!(
            error.to_string(),
            format!("{side} x {side} pixels take {needed_mb} MB in memory, above the limit of {limit_mb} MB")
        );
    }
    assert!(Photo::decode(b"P5\n65535 65535\n255\n").is_err());
    assert!(Photo::decode(b"P5\n4 4\n255\n\x01\x02").is_err(), "cut short");
}

/// A photo is read up to the limit, whatever its format, and not above it.
#[test]
fn the_limit_of_memory_is_the_only_one() {
    let eight = gradient();
    let jpeg = jpeg(eight.pixels.as_flattened(), image::ExtendedColorType::Rgb8);
    for bytes in [jpeg, encode_png(&eight).unwrap()] {
        assert!(Photo::decode_within(&bytes, 3600).is_ok());
        let error = Photo::decode_within(&bytes, 3599).unwrap_err();
        assert!(matches!(error, DecodeError::TooLarge(_)), "{error}");
    }
    // 100 megapixels and sides beyond 20,000 pixels pass by default.
    for (width, height) in [(11_656, 8_742), (60_000, 1_000)] {
        assert_eq!(TooLarge::check(width, height, 6, MAX_DECODED_BYTES), Ok(()));
    }
    let wide = Photo::decode(&[b"P5\n60000 2\n255\n".to_vec(), vec![9; 120_000]].concat()).unwrap();
    assert_eq!((wide.image.width, wide.image.at(59_999, 1)), (60_000, [9; 3]));
}

#[test]
fn a_format_that_is_not_read_is_named_with_the_way_out() {
    for (start, name) in [
        (&b"\0\0\0\x18ftypheic\0\0\0\0mif1heic"[..], "HEIC"),
        (b"\0\0\0\x18ftypmif1\0\0\0\0", "HEIF"),
        (b"\0\0\0\x1cftypavif\0\0\0\0", "AVIF"),
        (b"\0\0\0\x0cjP  \r\n\x87\n", "JPEG 2000"),
        (b"\0\0\0\x0cJXL \r\n\x87\n", "JPEG XL"),
        (b"\0\0\0\x18ftypisom\0\0\0\0", "a film (MP4, MOV)"),
    ] {
        let error = Photo::decode(start).unwrap_err().to_string();
        assert_eq!(error, format!("{name} is not read: save it as JPEG, PNG or TIFF"));
    }
}

/// Exif with orientation 6, as WebP has it and with the prefix that belongs to JPEG: 40 x 30 pixels become 30 x 40.
#[test]
fn a_webp_is_turned_by_exif_with_and_without_a_prefix() {
    let exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    for format in [ImageFormat::WebP, ImageFormat::Png] {
        for prefix in [&b"Exif\0\0"[..], b""] {
            let (mut bytes, image) = (Vec::new(), gradient());
            let exif = [prefix, exif].concat();
            let pixels = image.pixels.as_flattened();
            let color = image::ExtendedColorType::Rgb8;
            use image::ImageEncoder;
            if format == ImageFormat::WebP {
                let mut encoder = image::codecs::webp::WebPEncoder::new_lossless(&mut bytes);
                encoder.set_exif_metadata(exif).unwrap();
                encoder.write_image(pixels, 40, 30, color).unwrap();
            } else {
                let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
                encoder.set_exif_metadata(exif).unwrap();
                encoder.write_image(pixels, 40, 30, color).unwrap();
            }
            let turned = Photo::decode(&bytes).unwrap();
            assert_eq!(
                (turned.image.width, turned.image.height),
                (30, 40),
                "{format:?} {prefix:?}"
            );
            // The lower left corner comes to the upper left one.
            assert_eq!(turned.image.at(0, 0), image.at(0, 29), "{format:?} {prefix:?}");
        }
    }
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
    // The directory is at the end. Its bytes decide everything.
    let directory = whole.len().saturating_sub(400);
    for at in (0..8).chain(directory..whole.len()) {
        for value in [0, 1, 2, 3, 4, 5, 7, 16, 32, 127, 128, 255] {
            let mut damaged = whole.clone();
            damaged[at] = value;
            let _ = Photo::decode(&damaged);
        }
    }
}

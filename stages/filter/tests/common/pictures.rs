//! Small pictures made for the tests and benchmarks, the same on every machine.
#![allow(dead_code, reason = "each test binary uses its own part")]
#![allow(
    clippy::unwrap_used,
    reason = "helpers of tests: a fixture that is wrong should stop the test"
)]

use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageFormat};
use marf_scene::{Image, Srgb, encode_png};

/// Returns the value in [0, 255] of white noise at a pixel, the same on every machine.
pub fn noise(x: u32, y: u32, seed: u32) -> u8 {
    let mut state =
        x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ seed.wrapping_mul(0xc2b2_ae3d);
    state = (state ^ (state >> 15)).wrapping_mul(0x2c1b_3c6d);
    state = (state ^ (state >> 12)).wrapping_mul(0x297a_2d39);
    (state >> 24) as u8
}

/// Returns value noise in [0, 255]: random on a lattice of `cell` pixels, linear in between.
fn value_noise(x: u32, y: u32, cell: u32, seed: u32) -> f64 {
    let (column, row) = (x / cell, y / cell);
    let (u, v) = (
        f64::from(x % cell) / f64::from(cell),
        f64::from(y % cell) / f64::from(cell),
    );
    let at = |dx: u32, dy: u32| f64::from(noise(column + dx, row + dy, seed));
    (at(0, 0) * (1.0 - u) + at(1, 0) * u) * (1.0 - v) + (at(0, 1) * (1.0 - u) + at(1, 1) * u) * v
}

/// Returns a sharp, coloured picture of 320 x 240 pixels with structures of 2 to 64 pixels. No two seeds are alike.
pub fn ground(seed: u32) -> Image<Srgb> {
    Image::from_fn(320, 240, |x, y| {
        let octaves = [
            (64, 0.35),
            (32, 0.25),
            (16, 0.17),
            (8, 0.11),
            (4, 0.07),
            (2, 0.05),
        ];
        let sum: f64 = octaves
            .iter()
            .map(|(cell, part)| part * value_noise(x, y, *cell, seed + cell))
            .sum();
        let tint = value_noise(x, y, 32, seed + 1000) / 255.0;
        let shade = 30.0 + 0.7 * sum;
        [shade, shade * (0.6 + 0.2 * tint), shade * (0.25 + 0.35 * tint)].map(|value| value as u8)
    })
}

/// Returns the picture with a function applied to every pixel.
pub fn recoloured(image: &Image<Srgb>, color: impl Fn([u8; 3]) -> [u8; 3]) -> Image<Srgb> {
    Image::from_fn(image.width, image.height, |x, y| color(image.at(x, y)))
}

/// Returns one band of a picture, seen through a tinted filter.
pub fn narrow(image: &Image<Srgb>, band: usize, tint: [f64; 3]) -> Image<Srgb> {
    recoloured(image, |pixel| {
        tint.map(|tint| (tint * f64::from(pixel[band])).round() as u8)
    })
}

/// Returns the picture with a box mean over `length` pixels along the rows.
pub fn smeared(image: &Image<Srgb>, length: u32) -> Image<Srgb> {
    Image::from_fn(image.width, image.height, |x, y| {
        [0, 1, 2].map(|band| {
            let near = (0..length).map(|step| (x + step).min(image.width - 1));
            (near.map(|x| u32::from(image.at(x, y)[band])).sum::<u32>() / length) as u8
        })
    })
}

/// Encodes a picture as PNG.
pub fn png(image: &Image<Srgb>) -> Vec<u8> {
    encode_png(image).unwrap()
}

/// Returns a picture as a type of the `image` crate.
pub fn dynamic(image: &Image<Srgb>) -> DynamicImage {
    let bytes = image.pixels.as_flattened().to_vec();
    image::RgbImage::from_raw(image.width, image.height, bytes)
        .unwrap()
        .into()
}

/// Encodes a picture in a format of the `image` crate.
pub fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// Encodes a picture as JPEG of a quality in [1, 100].
pub fn jpeg(image: &DynamicImage, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let rgb = image.to_rgb8();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality)
        .write_image(&rgb, rgb.width(), rgb.height(), ExtendedColorType::Rgb8)
        .unwrap();
    bytes
}

/// Returns a JPEG with an EXIF segment of this orientation behind its start marker.
pub fn with_orientation(jpeg: &[u8], orientation: u8) -> Vec<u8> {
    let mut exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0]);
    let length = (exif.len() as u16 + 2).to_be_bytes();
    [&jpeg[..2], &[0xff, 0xe1], &length, &exif, &jpeg[2..]].concat()
}

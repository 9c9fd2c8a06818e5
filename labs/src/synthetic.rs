//! Synthetic photos, the same for the same numbers, and a pipeline that they pass.

use marf_numeric::{GOLDEN, mix};
use marf_scene::{Image, Srgb, encode_jpeg};

use crate::output::Result;

/// Five nodes of a pipeline behind an archive `photos`, with thresholds that small photos pass.
pub const FIVE_NODES: &str = include_str!("../five_nodes.toml");

/// Columns and rows of squares in a picture.
const SQUARES: [u32; 2] = [16, 12];
/// Quality of the JPEGs.
const QUALITY: u8 = 90;

/// How a picture is lit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shade {
    /// As it is.
    Full,
    /// With three quarters of the light.
    Dark,
    /// All gray.
    Empty,
}

/// Returns a picture of squares in random colours as JPEG: 12 KB at 160 x 120 pixels.
///
/// # Errors
/// Returns the error of the encoder.
pub fn picture(seed: u64, width: u32, height: u32, shade: Shade) -> Result<Vec<u8>> {
    let image: Image<Srgb> = Image::from_fn(width, height, |x, y| {
        let square = u64::from(y * SQUARES[1] / height * SQUARES[0] + x * SQUARES[0] / width);
        [0, 1, 2].map(|channel| {
            let light = random(seed, 1000 + square * 3 + channel) % 255;
            match shade {
                Shade::Full => light as u8,
                Shade::Dark => (light * 3 / 4) as u8,
                Shade::Empty => 120,
            }
        })
    });
    Ok(encode_jpeg(&image, QUALITY)?)
}

/// Returns a random number of a pair.
pub fn random(a: u64, b: u64) -> u64 {
    mix(a
        .wrapping_mul(GOLDEN)
        .wrapping_add(b.wrapping_mul(0xd1b5_4a32_d192_ed03)))
}

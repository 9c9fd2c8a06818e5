//! Pictures of squares in random colours, the same for the same numbers.

use marf_scene::{Image, Srgb, encode_jpeg};

use super::child::random;
use marf_run::Error;

/// Columns and rows of squares in a picture.
const SQUARES: (u32, u32) = (16, 12);
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

/// Returns a picture as JPEG: 12 KB at 160 x 120 pixels.
///
/// # Errors
/// What the encoder refuses.
pub fn picture(seed: u64, width: u32, height: u32, shade: Shade) -> Result<Vec<u8>, Error> {
    let image: Image<Srgb> = Image::from_fn(width, height, |x, y| {
        let square = u64::from(y * SQUARES.1 / height * SQUARES.0 + x * SQUARES.0 / width);
        let channel = |channel: u64| {
            let light = random(seed, 1000 + square * 3 + channel) % 255;
            match shade {
                Shade::Full => light as u8,
                Shade::Dark => (light * 3 / 4) as u8,
                Shade::Empty => 120,
            }
        };
        [channel(0), channel(1), channel(2)]
    });
    encode_jpeg(&image, QUALITY).map_err(|error| Error::failed(error.to_string()))
}

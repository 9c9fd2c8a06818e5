//! Animated GIFs.

use image::{
    Delay, Frame, RgbaImage,
    codecs::gif::{GifEncoder, Repeat},
};

use crate::{DecodeError, Image, Srgb};

/// Effort of the colour reduction, 1 (best) to 30; 10 is the encoder's own default.
const SPEED: i32 = 10;

/// Encodes pictures of one size as an endless animation; equal pictures give equal bytes. Returns `None` where `stop` said
/// so before one of them: a picture of 1920 x 1080 takes some tenths of a second.
///
/// `frames_per_second` is rounded to whole hundredths of a second a frame, as the format stores them.
///
/// # Errors
/// No picture, or pictures the encoder refuses.
pub fn encode_gif(
    pictures: &[Image<Srgb>],
    frames_per_second: u32,
    stop: &dyn Fn() -> bool,
) -> Result<Option<Vec<u8>>, DecodeError> {
    if pictures.is_empty() {
        return Err(damaged(&"an animation needs at least one picture"));
    }
    let mut bytes = Vec::new();
    let mut encoder = GifEncoder::new_with_speed(&mut bytes, SPEED);
    encoder
        .set_repeat(Repeat::Infinite)
        .map_err(|error| damaged(&error))?;
    let delay = Delay::from_numer_denom_ms(1000, frames_per_second.max(1));
    for picture in pictures {
        if stop() {
            return Ok(None);
        }
        let frame = Frame::from_parts(with_alpha(picture), 0, 0, delay);
        encoder.encode_frame(frame).map_err(|error| damaged(&error))?;
    }
    drop(encoder); // writes the trailer
    Ok(Some(bytes))
}

/// Returns an opaque picture with an alpha channel.
fn with_alpha(picture: &Image<Srgb>) -> RgbaImage {
    RgbaImage::from_fn(picture.width, picture.height, |column, row| {
        let [red, green, blue] = picture.at(column, row);
        image::Rgba([red, green, blue, 255])
    })
}

/// Returns the error of the encoder.
fn damaged(error: &dyn std::fmt::Display) -> DecodeError {
    DecodeError::Damaged {
        format: "GIF",
        message: error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use image::AnimationDecoder;

    fn gradient(shift: u32) -> Image<Srgb> {
        Image::from_fn(48, 32, |x, y| [(x * 5 + shift) as u8, (y * 7) as u8, 60])
    }

    #[test]
    fn an_animation_decodes_to_its_pictures_and_always_has_the_same_bytes() {
        let pictures = [gradient(0), gradient(9), gradient(18)];
        let bytes = encode_gif(&pictures, 12, &|| false).unwrap().unwrap();
        assert_eq!(encode_gif(&pictures, 12, &|| false).unwrap().unwrap(), bytes);
        let decoder = image::codecs::gif::GifDecoder::new(std::io::Cursor::new(&bytes)).unwrap();
        let frames = decoder.into_frames().collect_frames().unwrap();
        assert_eq!(frames.len(), 3);
        for (frame, picture) in frames.iter().zip(&pictures) {
            assert_eq!(frame.buffer().dimensions(), (48, 32));
            let close = frame
                .buffer()
                .pixels()
                .zip(&picture.pixels)
                .filter(|(pixel, rgb)| (0..3).all(|channel| pixel.0[channel].abs_diff(rgb[channel]) < 32));
            let close = close.count();
            assert!(close > 48 * 32 * 4 / 5, "{close} of {}", 48 * 32);
        }
    }

    #[test]
    fn an_empty_animation_is_refused() {
        assert!(
            encode_gif(&[], 12, &|| false)
                .unwrap_err()
                .to_string()
                .contains("at least one picture")
        );
    }

    #[test]
    fn an_animation_can_be_stopped_before_every_picture() {
        let pictures = [gradient(0), gradient(9), gradient(18)];
        for before in 0..=pictures.len() {
            let asked = Cell::new(0);
            let stop = || asked.replace(asked.get() + 1) == before;
            let encoded = encode_gif(&pictures, 12, &stop).unwrap();
            assert_eq!(
                encoded.is_none(),
                before < pictures.len(),
                "before picture {before}"
            );
        }
    }
}

//! Limits of pictures, and settings of their encoding.

use crate::error::VideoError;
use crate::limits::{MAX_LONG_PX, MAX_SHORT_PX};

/// Least and most pictures a second.
pub const RATES: std::ops::RangeInclusive<u32> = 1..=240;
/// Quantisers (QP of H.264), finest first. OpenH264 keeps to none finer than 12.
pub const QUANTIZERS: std::ops::RangeInclusive<u32> = 12..=51;
/// Pictures from one from which decoding can begin to the next: two seconds at 24 a second, so that a player can jump.
pub(crate) const KEY_EVERY: u32 = 48;

/// Checks that this build has the encoder.
///
/// # Errors
/// [`VideoError::NoEncoder`] without its feature.
pub fn check_built_in() -> Result<(), VideoError> {
    if cfg!(feature = "h264") {
        Ok(())
    } else {
        Err(VideoError::NoEncoder)
    }
}

/// Settings of the encoding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Pictures a second, in [`RATES`].
    pub frames_per_second: u32,
    /// Quantiser of every block, in [`QUANTIZERS`]: 6 more halves the precision.
    pub quantizer: u32,
}

impl Settings {
    /// Checks what can be checked without a picture.
    ///
    /// # Errors
    /// A number out of its range.
    pub fn check(&self) -> Result<(), VideoError> {
        if !RATES.contains(&self.frames_per_second) {
            let rate = self.frames_per_second;
            return Err(VideoError::Rate { rate });
        }
        if !QUANTIZERS.contains(&self.quantizer) {
            let quantizer = self.quantizer;
            return Err(VideoError::Quantizer { quantizer });
        }
        Ok(())
    }
}

/// Checks that pictures of a size in pixels can be encoded.
///
/// # Errors
/// A side of 0, or more than [`MAX_LONG_PX`] x [`MAX_SHORT_PX`] in either orientation.
pub fn check_size(width: u32, height: u32) -> Result<(), VideoError> {
    if width == 0 || height == 0 {
        return Err(VideoError::Empty { width, height });
    }
    if width.max(height) > MAX_LONG_PX || width.min(height) > MAX_SHORT_PX {
        return Err(VideoError::TooLarge { width, height });
    }
    Ok(())
}

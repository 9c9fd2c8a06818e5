//! Pictures of one size to an MP4 file: H.264, 4:2:0, BT.709 of limited range, a constant quantiser.
//!
//! ```text
//! RGB ─ yuv (integers) ─ h264 (OpenH264, one thread) ─ nal (parameter sets, samples) ─ mp4 (ftyp, moov, mdat)
//! ```
//! Invariant: the same pictures and settings give the same bytes. No clock is read, one thread encodes, and OpenH264 is built to
//! give the same bits on every instruction set: its C code and its AVX2 code (built where `nasm` is found) gave equal streams in
//! 16 of 16 cases from 18 x 34 to 1920 x 1080. A bit rate is never aimed at, so no picture is dropped or spoilt to hold one.
//!
//! Without the feature `h264` (on by default) nothing is compiled in C++, and [`Encoder::new`] refuses.

#[cfg(not(feature = "h264"))]
mod absent;
#[cfg(feature = "h264")]
mod encoder;
mod error;
#[cfg(feature = "h264")]
mod h264;
#[cfg(feature = "h264")]
mod mp4;
#[cfg(feature = "h264")]
mod nal;
#[cfg(feature = "h264")]
mod yuv;

#[cfg(not(feature = "h264"))]
pub use absent::Encoder;
#[cfg(feature = "h264")]
pub use encoder::Encoder;
pub use error::VideoError;

/// Most pixels along the longer side of a picture, and along the shorter one: what OpenH264 takes.
pub const MAX_LONG_PX: u32 = 3840;
/// See [`MAX_LONG_PX`].
pub const MAX_SHORT_PX: u32 = 2160;
/// Least and most pictures a second.
pub const RATES: std::ops::RangeInclusive<u32> = 1..=240;
/// Quantisers (QP of H.264) that the encoder keeps to, finest first; it has no finer one than 12.
pub const QUANTIZERS: std::ops::RangeInclusive<u32> = 12..=51;

/// How pictures are encoded.
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

/// Checks that this build has the encoder.
///
/// # Errors
/// [`VideoError::NoEncoder`] without the feature `h264`.
pub fn check_encoder() -> Result<(), VideoError> {
    if cfg!(feature = "h264") {
        Ok(())
    } else {
        Err(VideoError::NoEncoder)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_taken_up_to_ultra_high_definition_in_both_orientations() {
        for (width, height) in [(1, 1), (3840, 2160), (2160, 3840), (3839, 1)] {
            assert_eq!(check_size(width, height), Ok(()), "{width} x {height}");
        }
        for (width, height) in [(3841, 2), (2, 3841), (2161, 2161), (u32::MAX, u32::MAX)] {
            let error = VideoError::TooLarge { width, height };
            assert_eq!(check_size(width, height), Err(error), "{width} x {height}");
        }
        for (width, height) in [(0, 5), (5, 0)] {
            assert_eq!(
                check_size(width, height),
                Err(VideoError::Empty { width, height })
            );
        }
    }

    #[test]
    fn rates_and_quantisers_are_checked() {
        let settings = |frames_per_second, quantizer| Settings {
            frames_per_second,
            quantizer,
        };
        for (rate, quantizer) in [(1, 12), (240, 51), (24, 24)] {
            assert_eq!(settings(rate, quantizer).check(), Ok(()), "{rate} {quantizer}");
        }
        for (rate, quantizer) in [(0, 24), (241, 24), (24, 11), (24, 52)] {
            assert!(settings(rate, quantizer).check().is_err(), "{rate} {quantizer}");
        }
    }

    #[test]
    fn a_build_without_the_encoder_says_so() {
        assert_eq!(check_encoder().is_ok(), cfg!(feature = "h264"));
        let settings = Settings {
            frames_per_second: 24,
            quantizer: 24,
        };
        assert_eq!(Encoder::new(settings).is_ok(), cfg!(feature = "h264"));
    }
}

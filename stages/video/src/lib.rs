//! Pictures of one size to an MP4 file: H.264 or AV1, 4:2:0, BT.709 of limited range, a constant quantiser.
//!
//! ```text
//! RGB ─ yuv (integers) ─┬─ h264 (OpenH264) ─ nal (parameter sets, samples) ─┬─ mp4 (ftyp, moov, mdat)
//!                       └─ av1 (rav1e: units to samples) ───────────────────┘
//! ```
//! Invariant: the same pictures and settings give the same bytes. No clock is read and one thread encodes. A bit rate is never
//! aimed at, so no picture is dropped or spoilt to hold one.
//!
//! Between machines: OpenH264 is built to give the same bits on every instruction set; its C code and its AVX2 code (built where
//! `nasm` is found) gave equal streams in 16 of 16 cases from 18 x 34 to 1920 x 1080. rav1e is built without assembler and decides
//! in integers, but for what a bit weighs against an error: floats, multiplied and added alike everywhere, under a factor from the
//! `exp` of the platform's C library. Where that differs in its last bit, a block may be split otherwise: such streams have not
//! been seen, and cannot be ruled out. Decoders of AV1 give the same pixels everywhere.
//!
//! A codec is a cargo feature (`h264`, `av1`, both on by default); [`Encoder::new`] refuses one that is not built in.
#![cfg_attr(
    not(any(feature = "h264", feature = "av1")),
    allow(dead_code, reason = "without a codec nothing is encoded")
)]

#[cfg(feature = "av1")]
mod av1;
mod encoder;
mod error;
#[cfg(feature = "h264")]
mod h264;
mod mp4;
#[cfg(feature = "h264")]
mod nal;
mod yuv;

pub use encoder::Encoder;
pub use error::VideoError;

/// Most pixels along the longer side of a picture, and along the shorter one: what OpenH264 takes (rav1e takes more).
pub const MAX_LONG_PX: u32 = 3840;
/// See [`MAX_LONG_PX`].
pub const MAX_SHORT_PX: u32 = 2160;
/// Least and most pictures a second.
pub const RATES: std::ops::RangeInclusive<u32> = 1..=240;
/// Quantisers (QP of H.264) of both codecs, finest first; OpenH264 keeps to no finer one than 12. AV1 takes the nearest of its own.
pub const QUANTIZERS: std::ops::RangeInclusive<u32> = 12..=51;
/// Pictures from one from which decoding can begin to the next: two seconds at 24 a second, so that a player can jump.
#[cfg(any(feature = "h264", feature = "av1"))]
pub(crate) const KEY_EVERY: u32 = 48;

/// What pictures are encoded as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Codec {
    /// H.264, constrained baseline, by OpenH264.
    H264,
    /// AV1, main profile, by rav1e.
    Av1,
}

impl Codec {
    /// Every codec, built in or not.
    pub const ALL: [Self; 2] = [Self::H264, Self::Av1];

    /// Returns the cargo feature that builds it in.
    pub const fn feature(self) -> &'static str {
        match self {
            Self::H264 => "h264",
            Self::Av1 => "av1",
        }
    }

    /// Checks that this build has it.
    ///
    /// # Errors
    /// [`VideoError::NoEncoder`] without its feature.
    pub fn check(self) -> Result<(), VideoError> {
        let is_there = match self {
            Self::H264 => cfg!(feature = "h264"),
            Self::Av1 => cfg!(feature = "av1"),
        };
        match is_there {
            true => Ok(()),
            false => Err(VideoError::NoEncoder { codec: self }),
        }
    }
}

impl std::fmt::Display for Codec {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            Self::H264 => "H.264",
            Self::Av1 => "AV1",
        })
    }
}

/// How pictures are encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// What they become.
    pub codec: Codec,
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
            codec: Codec::H264,
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
    fn a_build_without_an_encoder_names_its_feature() {
        for codec in Codec::ALL {
            let settings = Settings {
                codec,
                frames_per_second: 24,
                quantizer: 24,
            };
            let opened = Encoder::new(settings).map(|_| ());
            assert_eq!(opened, codec.check(), "{codec}");
            if let Err(error) = opened {
                assert!(error.to_string().contains(&format!("`{}`", codec.feature())));
            }
        }
    }
}

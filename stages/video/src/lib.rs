//! Pictures of one size to an MP4 file: H.264 or AV1, 4:2:0, BT.709 of limited range, a constant quantiser.
//!
//! ```text
//! RGB ─ yuv (integers) ─┬─ h264 (OpenH264) ─ nal (parameter sets, samples) ─┬─ mp4 (ftyp, moov, mdat)
//!                       └─ av1 (rav1e: units to samples) ───────────────────┘
//! ```
//! Invariant: the same pictures and settings give the same bytes. No clock is read and one thread encodes. A bit rate is never
//! aimed at, so no picture is dropped or spoilt to hold one.
//!
//! Between machines: OpenH264 is built to give the same bits on every instruction set. Its C code and its
//! AVX2 code (built if `nasm` is found) gave equal streams in 16 of 16 cases from 18 x 34 to 1920 x 1080.
//! rav1e is built without assembler and decides in integers, except for the weight of a bit against an error.
//! That weight is in floats, multiplied and added alike everywhere, under a factor from the `exp` of the
//! platform's C library. If `exp` differs in its last bit, a block may be split otherwise. Such streams have
//! not been seen, and cannot be ruled out. Decoders of AV1 give the same pixels everywhere.
//!
//! A codec is a cargo feature (`h264`, `av1`, both on by default in this crate). The program `marf` has `h264` on and `av1` off by
//! default. [`Encoder::new`] refuses a codec that is not built in.
#![cfg_attr(
    not(any(feature = "h264", feature = "av1")),
    allow(dead_code, reason = "without a codec nothing is encoded")
)]

#[cfg(feature = "av1")]
mod av1;
mod codec;
mod encoder;
mod error;
#[cfg(feature = "h264")]
mod h264;
mod mp4;
#[cfg(feature = "h264")]
mod nal;
mod sample;
mod settings;
mod yuv;

pub use codec::{Codec, MAX_LONG_PX, MAX_SHORT_PX};
pub use encoder::Encoder;
pub use error::VideoError;
#[cfg(any(feature = "h264", feature = "av1"))]
pub(crate) use settings::KEY_EVERY;
pub use settings::{QUANTIZERS, RATES, Settings, check_size};

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

//! Pictures of one size to an MP4 file: H.264, 4:2:0, BT.709 of limited range, a constant quantiser.
//!
//! ```text
//! RGB ─ yuv (integers) ─ h264 (OpenH264) ─ nal (parameter sets, samples) ─ mp4 (ftyp, moov, mdat)
//! ```
//! Invariant: the same pictures and settings give the same bytes. No clock is read and one thread encodes. A bit rate is never
//! aimed at, so no picture is dropped or spoilt to hold one.
//!
//! Between machines: OpenH264 is built to give the same bits on every instruction set. Its C code and its
//! AVX2 code (built if `nasm` is found) gave equal streams in 16 of 16 cases from 18 x 34 to 1920 x 1080.
//!
//! The encoder is the cargo feature `h264`, on by default. Without it [`Encoder::new`] refuses.
#![cfg_attr(
    not(feature = "h264"),
    allow(dead_code, reason = "without an encoder nothing is encoded")
)]

mod encoder;
mod error;
#[cfg(feature = "h264")]
mod h264;
mod limits;
mod mp4;
#[cfg(feature = "h264")]
mod nal;
mod sample;
mod settings;
mod yuv;

pub use encoder::Encoder;
pub use error::VideoError;
pub use settings::{QUANTIZERS, RATES, Settings, check_built_in, check_size};

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
    fn a_build_without_an_encoder_names_its_feature() {
        let settings = Settings {
            frames_per_second: 24,
            quantizer: 24,
        };
        let opened = Encoder::new(settings).map(|_| ());
        assert_eq!(opened, check_built_in());
        assert!(opened.is_ok_and(|()| cfg!(feature = "h264")) || !cfg!(feature = "h264"));
    }
}

use crate::limits::{MAX_LONG_PX, MAX_SHORT_PX};

/// Errors of encoding a video.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum VideoError {
    /// The program was built without the encoder.
    #[error("this build has no encoder of H.264 (cargo feature `h264`)")]
    NoEncoder,
    /// Nothing to encode.
    #[error("a video needs at least one picture")]
    NoPictures,
    /// A picture without pixels.
    #[error("a picture of {width} x {height} pixels shows nothing")]
    Empty {
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
    },
    /// A picture beyond the limits of the encoder.
    #[error(
        "pictures have {width} x {height} pixels: a video has at most {MAX_LONG_PX} x {MAX_SHORT_PX}, in either orientation"
    )]
    TooLarge {
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
    },
    /// Pictures of two sizes.
    #[error("picture {picture} has {width} x {height} pixels, the first one {first_width} x {first_height}")]
    Size {
        /// Number of the picture, from 1.
        picture: usize,
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
        /// Width of the first.
        first_width: u32,
        /// Height of the first.
        first_height: u32,
    },
    /// A rate out of range.
    #[error("{rate} pictures a second: a video has 1 to 240")]
    Rate {
        /// Pictures a second.
        rate: u32,
    },
    /// A quantiser out of range.
    #[error("quantiser {quantizer}: a video has 12 (finest) to 51")]
    Quantizer {
        /// The quantiser.
        quantizer: u32,
    },
    /// More bytes than the boxes can say.
    #[error("the video takes {bytes} bytes, an MP4 file of this kind holds less than 4 GiB")]
    TooLong {
        /// Bytes of the encoded pictures.
        bytes: u64,
    },
    /// The encoder failed.
    #[error("picture {picture}: the encoder of H.264 failed: {cause}")]
    Encoder {
        /// Number of the picture, from 1.
        picture: usize,
        /// Its message.
        cause: String,
    },
}

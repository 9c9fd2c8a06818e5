//! Codecs, and the largest pictures that they take.

/// Most pixels along the longer side of a picture, and along the shorter one: what OpenH264 takes (rav1e takes more).
pub const MAX_LONG_PX: u32 = 3840;
/// See [`MAX_LONG_PX`].
pub const MAX_SHORT_PX: u32 = 2160;

/// Codec of a video.
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
}

impl std::fmt::Display for Codec {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            Self::H264 => "H.264",
            Self::Av1 => "AV1",
        })
    }
}

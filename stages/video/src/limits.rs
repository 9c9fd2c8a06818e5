//! The largest pictures that OpenH264 takes.

/// Most pixels along the longer side of a picture.
pub(crate) const MAX_LONG_PX: u32 = 3840;
/// Most pixels along the shorter side.
pub(crate) const MAX_SHORT_PX: u32 = 2160;

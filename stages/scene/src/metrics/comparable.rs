//! Whether two images can be compared.

use crate::{Image, Srgb};

/// Two images that cannot be compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum MetricError {
    /// The sizes differ.
    #[error("{} x {} pixels cannot be compared with {} x {}", .a.0, .a.1, .b.0, .b.1)]
    Size {
        /// Width and height of the first image.
        a: (u32, u32),
        /// Width and height of the second one.
        b: (u32, u32),
    },
    /// The images have fewer pixels than the metric needs.
    #[error("{width} x {height} pixels, at least {min} a side are needed")]
    TooSmall {
        /// Width of both.
        width: u32,
        /// Height of both.
        height: u32,
        /// Pixels needed a side.
        min: u32,
    },
    /// All that could be compared is hidden.
    #[error("a mask hides all that could be compared")]
    Hidden,
    /// The photo is black, so [`psnr_paper`] has no peak.
    #[error("the photo is black everywhere: it has no peak to measure against")]
    NoPeak,
}

/// Pixels that a comparison leaves out, `[height * width]`. Empty means none.
pub type Hidden<'a> = &'a [bool];

/// Checks that two images have the same size, and at least `min` pixels a side.
pub(super) fn check(a: &Image<Srgb>, b: &Image<Srgb>, min: u32) -> Result<(), MetricError> {
    let (width, height) = (a.width, a.height);
    if (width, height) != (b.width, b.height) {
        let b = (b.width, b.height);
        return Err(MetricError::Size {
            a: (width, height),
            b,
        });
    }
    if width < min || height < min {
        return Err(MetricError::TooSmall { width, height, min });
    }
    Ok(())
}

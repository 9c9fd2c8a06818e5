use std::fmt::Display;

use super::plan::SOLS;

/// A failure to make the demo's files.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DemoError {
    /// The caller asked to stop.
    #[error("stopped")]
    Cancelled,
    /// A sol that does not exist.
    #[error("the demo has no sol {sol}: use one of {} to {}", SOLS.start(), SOLS.end())]
    Sol {
        /// The sol.
        sol: u32,
    },
    /// A photo too small or too large to draw.
    #[error("the demo draws photos of 16 to 4096 pixels a side, not {width_px} x {height_px}")]
    Size {
        /// Width.
        width_px: u32,
        /// Height.
        height_px: u32,
    },
    /// A file that is not a good photo of the sol.
    #[error("the demo took no good photo `{file}` on sol {sol}")]
    File {
        /// The file's name.
        file: String,
        /// The sol.
        sol: u32,
    },
    /// An image that could not be encoded.
    #[error("`{file}` could not be encoded: {message}")]
    Encode {
        /// Name of the file.
        file: String,
        /// The encoder's error.
        message: String,
    },
}

impl DemoError {
    /// Returns the error of a file that an encoder refused.
    pub(super) fn encode(file: String, error: impl Display) -> Self {
        let message = error.to_string();
        Self::Encode { file, message }
    }
}

use marf_scene::{Image, Srgb};

use crate::{Settings, VideoError};

/// The encoder of a build without the feature `h264`: there is none.
#[derive(Debug)]
pub enum Encoder {}

impl Encoder {
    /// Refuses.
    ///
    /// # Errors
    /// Always [`VideoError::NoEncoder`].
    pub fn new(_settings: Settings) -> Result<Self, VideoError> {
        Err(VideoError::NoEncoder)
    }

    /// Never called.
    ///
    /// # Errors
    /// None.
    pub fn push(&mut self, _picture: &Image<Srgb>) -> Result<(), VideoError> {
        match *self {}
    }

    /// Never called.
    ///
    /// # Errors
    /// None.
    pub fn finish(self) -> Result<Vec<u8>, VideoError> {
        match self {}
    }
}

use marf_scene::{Image, Srgb};

use crate::{
    Settings, VideoError, check_size,
    h264::H264,
    mp4::{self, Track},
    yuv::{Yuv, side},
};

/// Encodes pictures one after the other; only what they become is kept in memory.
#[derive(Debug)]
pub struct Encoder {
    codec: H264,
    track: Track,
    /// Width and height of the first picture.
    size: Option<(u32, u32)>,
}

impl Encoder {
    /// Opens an encoder.
    ///
    /// # Errors
    /// Settings out of range, or an encoder that does not open.
    pub fn new(settings: Settings) -> Result<Self, VideoError> {
        settings.check()?;
        let codec = H264::new(&settings).map_err(|error| failed(1, &error))?;
        Ok(Self {
            codec,
            track: Track::new(settings.frames_per_second),
            size: None,
        })
    }

    /// Encodes the next picture. A side that is odd gets one more pixel and one below 16 as many as it lacks, which
    /// repeat the last.
    ///
    /// # Errors
    /// A size that cannot be encoded or is not that of the first picture; a failure of the encoder.
    pub fn push(&mut self, picture: &Image<Srgb>) -> Result<(), VideoError> {
        self.check(picture)?;
        let index = self.track.samples.len();
        let units = self.codec.encode(&Yuv::of(picture), index as u64);
        let units = units.map_err(|error| failed(index + 1, &error))?;
        if units.sample.is_empty() {
            return Err(failed(index + 1, &"it gave nothing"));
        }
        self.track.add(units).map_err(|cause| failed(index + 1, &cause))
    }

    /// Checks the size of a picture; the first one decides it.
    fn check(&mut self, picture: &Image<Srgb>) -> Result<(), VideoError> {
        let (width, height) = (picture.width, picture.height);
        let (first_width, first_height) = match self.size {
            Some(first) => first,
            None => {
                check_size(width, height)?;
                self.size = Some((width, height));
                (self.track.width, self.track.height) = (side(width), side(height));
                (width, height)
            }
        };
        if (width, height) != (first_width, first_height) {
            return Err(VideoError::Size {
                picture: self.track.samples.len() + 1,
                width,
                height,
                first_width,
                first_height,
            });
        }
        Ok(())
    }

    /// Returns the bytes of the MP4 file.
    ///
    /// # Errors
    /// No picture, or more bytes than the format of this writer holds.
    pub fn finish(self) -> Result<Vec<u8>, VideoError> {
        mp4::write(&self.track)
    }
}

fn failed(picture: usize, cause: &dyn std::fmt::Display) -> VideoError {
    VideoError::Encoder {
        picture,
        cause: cause.to_string(),
    }
}

use marf_scene::{Image, Srgb};

use crate::{
    Settings, VideoError, check_built_in, check_size,
    mp4::{self, Track},
    sample::Sample,
    yuv::{Yuv, side},
};

/// Encodes pictures one after the other. Only their samples are kept in memory.
pub struct Encoder {
    #[cfg(feature = "h264")]
    coder: crate::h264::H264,
    track: Track,
    /// Pictures taken.
    pictures: usize,
    /// Width and height of the first picture.
    size: (u32, u32),
}

impl Encoder {
    /// Opens the encoder.
    ///
    /// # Errors
    /// Settings out of range, a build without the encoder, an error of the encoder.
    pub fn new(settings: Settings) -> Result<Self, VideoError> {
        settings.check()?;
        check_built_in()?;
        Ok(Self {
            #[cfg(feature = "h264")]
            coder: crate::h264::H264::new(&settings)
                .map_err(|cause| VideoError::Encoder { picture: 1, cause })?,
            track: Track::new(settings.frames_per_second),
            pictures: 0,
            size: (0, 0),
        })
    }

    /// Encodes the next picture. A side that is odd gets one more pixel and one below 16 as many as it lacks, which
    /// repeat the last.
    ///
    /// # Errors
    /// A size that cannot be encoded or is not that of the first picture. A failure of the encoder.
    pub fn push(&mut self, picture: &Image<Srgb>) -> Result<(), VideoError> {
        let (width, height) = (picture.width, picture.height);
        if self.pictures == 0 {
            check_size(width, height)?;
            self.size = (width, height);
            (self.track.width, self.track.height) = (side(width), side(height));
        }
        let (first_width, first_height) = self.size;
        if (width, height) != self.size {
            return Err(VideoError::Size {
                picture: self.pictures + 1,
                width,
                height,
                first_width,
                first_height,
            });
        }
        self.pictures += 1;
        let sample = self.encoded(&Yuv::from_image(picture));
        let added = sample.and_then(|sample| self.track.add(sample).map_err(str::to_owned));
        added.map_err(|cause| VideoError::Encoder {
            picture: self.pictures,
            cause,
        })
    }

    #[cfg(feature = "h264")]
    fn encoded(&mut self, picture: &Yuv) -> Result<Sample, String> {
        self.coder.encode(picture)
    }

    #[cfg(not(feature = "h264"))]
    fn encoded(&mut self, _picture: &Yuv) -> Result<Sample, String> {
        Err("it is not built in".to_owned())
    }

    /// Returns the bytes of the MP4 file.
    ///
    /// # Errors
    /// No picture, or more bytes than the format of this writer holds.
    pub fn finish(self) -> Result<Vec<u8>, VideoError> {
        mp4::write(&self.track)
    }
}

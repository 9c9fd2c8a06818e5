use marf_scene::{Image, Srgb};

use crate::{
    Settings, VideoError, check_size,
    mp4::{self, Track},
    sample::{Coder, Sample},
    yuv::{Yuv, side},
};

/// Encodes pictures one after the other. Only their samples are kept in memory.
pub struct Encoder {
    settings: Settings,
    /// Opened by the first picture, whose size it needs.
    coder: Option<Box<dyn Coder>>,
    track: Track,
    /// Pictures taken.
    pictures: usize,
    /// Width and height of the first picture.
    size: (u32, u32),
}

impl Encoder {
    /// Checks the settings. The codec itself is opened by the first picture.
    ///
    /// # Errors
    /// Settings out of range, a codec that this build lacks.
    pub fn new(settings: Settings) -> Result<Self, VideoError> {
        settings.check()?;
        settings.codec.check()?;
        Ok(Self {
            settings,
            coder: None,
            track: Track::new(settings.codec, settings.frames_per_second),
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
        if self.coder.is_none() {
            self.coder = Some(self.open(width, height)?);
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
        let coder = self.coder.as_mut();
        let samples = coder.map_or(Ok(Vec::new()), |coder| coder.encode(&Yuv::from_image(picture)));
        self.add(samples)
    }

    /// Opens the codec for pictures of a size.
    fn open(&mut self, width: u32, height: u32) -> Result<Box<dyn Coder>, VideoError> {
        check_size(width, height)?;
        self.size = (width, height);
        (self.track.width, self.track.height) = (side(width), side(height));
        let opened = open(&self.settings, self.track.width, self.track.height);
        opened.map_err(|cause| self.failed(1, cause))
    }

    fn add(&mut self, samples: Result<Vec<Sample>, String>) -> Result<(), VideoError> {
        let track = &mut self.track;
        let added = samples.and_then(|samples| {
            let mut samples = samples.into_iter();
            samples.try_for_each(|sample| track.add(sample).map_err(str::to_owned))
        });
        added.map_err(|cause| self.failed(self.pictures, cause))
    }

    fn failed(&self, picture: usize, cause: String) -> VideoError {
        VideoError::Encoder {
            picture,
            codec: self.settings.codec,
            cause,
        }
    }

    /// Returns the bytes of the MP4 file.
    ///
    /// # Errors
    /// No picture, a failure of the encoder, or more bytes than the format of this writer holds.
    pub fn finish(mut self) -> Result<Vec<u8>, VideoError> {
        if let Some(mut coder) = self.coder.take() {
            self.add(coder.finish())?;
        }
        if self.track.samples.len() != self.pictures {
            let given = self.track.samples.len();
            return Err(self.failed(self.pictures, format!("it gave {given} pictures")));
        }
        mp4::write(&self.track)
    }
}

/// Opens a codec for checked settings and a size, which H.264 learns from its pictures.
///
/// # Errors
/// An error of the encoder.
#[cfg_attr(not(feature = "av1"), allow(unused_variables, reason = "the size is for AV1"))]
fn open(settings: &Settings, width: u32, height: u32) -> Result<Box<dyn Coder>, String> {
    match settings.codec {
        #[cfg(feature = "h264")]
        crate::Codec::H264 => Ok(Box::new(crate::h264::H264::new(settings)?)),
        #[cfg(feature = "av1")]
        crate::Codec::Av1 => Ok(Box::new(crate::av1::Av1::new(settings, width, height)?)),
        #[cfg(not(all(feature = "h264", feature = "av1")))]
        codec => Err(format!("{codec} is not built in")),
    }
}

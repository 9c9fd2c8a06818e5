//! H.264 by OpenH264 at a constant quantiser.

use openh264::{
    OpenH264API, Timestamp,
    encoder::{
        BitRate, Encoder, EncoderConfig, FrameRate, IntraFramePeriod, QpRange, RateControlMode, UsageType,
        VuiConfig,
    },
    formats::YUVSource,
};

use crate::{Settings, nal::Units, sample::Sample, settings::KEY_EVERY, yuv::Yuv};

/// Chooses the level that the stream claims and nothing else: 3.1 and up, at most 14 Mb/s (table A-1), which every player of
/// the last fifteen years takes.
const LEVEL_BITS_PER_SECOND: u32 = 12_000_000;
/// OpenH264 takes no higher rate. Only the level follows from it.
const MAX_LEVEL_RATE: u32 = 60;

/// An encoder of one video.
pub(crate) struct H264 {
    encoder: Encoder,
    rate: u32,
    /// Pictures taken.
    pictures: u64,
}

impl H264 {
    /// Opens an encoder for checked settings.
    ///
    /// # Errors
    /// An error of OpenH264.
    pub fn new(settings: &Settings) -> Result<Self, String> {
        let encoder = Encoder::with_api_config(OpenH264API::from_source(), config(settings));
        Ok(Self {
            encoder: encoder.map_err(|error| error.to_string())?,
            rate: settings.frames_per_second,
            pictures: 0,
        })
    }

    /// Encodes the next picture.
    ///
    /// # Errors
    /// An error of OpenH264.
    pub fn encode(&mut self, picture: &Yuv) -> Result<Sample, String> {
        let at = Timestamp::from_millis(self.pictures * 1000 / u64::from(self.rate));
        self.pictures += 1;
        let stream = self.encoder.encode_at(&Planes(picture), at);
        let stream = stream.map_err(|error| error.to_string())?;
        let mut units = Units::default();
        for layer in (0..stream.num_layers()).filter_map(|index| stream.layer(index)) {
            (0..layer.nal_count())
                .filter_map(|unit| layer.nal_unit(unit))
                .for_each(|unit| units.add(unit));
        }
        Ok(units.into_sample())
    }
}

/// Returns the configuration: everything that adapts to content or to a rate is off.
///
/// Only the rate control mode `Bufferbased` takes a quantiser for all blocks and no target bit rate. Its
/// quantiser is clipped to the range, which has one value.
fn config(settings: &Settings) -> EncoderConfig {
    let quantizer = settings.quantizer as u8;
    EncoderConfig::new()
        .num_threads(1)
        .skip_frames(false)
        .rate_control_mode(RateControlMode::Bufferbased)
        .qp(QpRange::new(quantizer, quantizer))
        .bitrate(BitRate::from_bps(LEVEL_BITS_PER_SECOND))
        .max_frame_rate(FrameRate::from_hz(
            settings.frames_per_second.min(MAX_LEVEL_RATE) as f32
        ))
        .usage_type(UsageType::CameraVideoRealTime)
        .intra_frame_period(IntraFramePeriod::from_num_frames(KEY_EVERY))
        .scene_change_detect(false)
        .adaptive_quantization(false)
        .background_detection(false)
        .vui(VuiConfig::bt709())
}

/// A picture as OpenH264 reads it.
struct Planes<'a>(&'a Yuv);

impl YUVSource for Planes<'_> {
    fn dimensions(&self) -> (usize, usize) {
        (self.0.width, self.0.height)
    }

    fn strides(&self) -> (usize, usize, usize) {
        (self.0.width, self.0.width / 2, self.0.width / 2)
    }

    fn y(&self) -> &[u8] {
        &self.0.y
    }

    fn u(&self) -> &[u8] {
        &self.0.cb
    }

    fn v(&self) -> &[u8] {
        &self.0.cr
    }
}

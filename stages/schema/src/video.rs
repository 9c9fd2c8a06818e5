//! `video`: pictures in order to a file that plays.

use marf_cache::Digest;
use marf_stage::{Document, ParamError, Params};
use marf_video::{QUANTIZERS, RATES, Settings};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::RenderParams;

/// How pictures are encoded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Codec {
    /// H.264, constrained baseline: every browser and player reads it. Needs the cargo feature `h264`.
    #[default]
    H264,
    /// AV1: its makers license their patents without fees, and browsers and players since about 2020 read it.
    /// Takes about ten times as long. Needs the cargo feature `av1`.
    Av1,
}

impl Codec {
    /// Returns the encoder's name of it.
    fn encoder(self) -> marf_video::Codec {
        match self {
            Self::H264 => marf_video::Codec::H264,
            Self::Av1 => marf_video::Codec::Av1,
        }
    }
}

/// Parameters of `video`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct VideoParams {
    /// How pictures are encoded.
    pub codec: Codec,
    /// Pictures a second, 1 to 240.
    pub fps: u32,
    /// Quantiser of every block, 12 (finest, largest file) to 51. 6 more halve the precision, and about the
    /// bytes. The numbers are those of H.264. AV1 takes its nearest step.
    pub quantizer: u32,
}

impl Default for VideoParams {
    fn default() -> Self {
        Self {
            codec: Codec::default(),
            fps: 24,
            quantizer: 26,
        }
    }
}

impl Params for VideoParams {
    const STAGE: &'static str = "video";
}

impl VideoParams {
    /// Checks that this program can encode so, before anything is rendered.
    ///
    /// # Errors
    /// Names the key: a codec that this build lacks, a number out of its range.
    pub fn check(&self) -> Result<(), ParamError> {
        let within = |key: &str, value: u32, range: std::ops::RangeInclusive<u32>| {
            let message = || format!("{value} is not in {} to {}", range.start(), range.end());
            if range.contains(&value) {
                return Ok(());
            }
            Err(ParamError::new(key, message()))
        };
        within("fps", self.fps, RATES)?;
        within("quantizer", self.quantizer, QUANTIZERS)?;
        self.codec.encoder().check().map_err(|error| {
            let message = format!(
                "{error}: build marf with it, take another `codec`, or leave the nodes of `video` out"
            );
            ParamError::new("codec", message)
        })
    }

    /// Returns the settings of the encoder.
    pub fn settings(&self) -> Settings {
        Settings {
            codec: self.codec.encoder(),
            frames_per_second: self.fps,
            quantizer: self.quantizer,
        }
    }
}

/// Output `film` of `render`: the pictures of a path in order (PNG), which `video` encodes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Film(pub Vec<Digest>);

impl Document for Film {
    const STAGE: &'static str = RenderParams::STAGE;
    const OUTPUT: &'static str = "film";
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn numbers_out_of_range_are_refused_by_key() {
        for (table, key) in [
            (json!({"fps": 0}), "fps"),
            (json!({"fps": 241}), "fps"),
            (json!({"quantizer": 11}), "quantizer"),
            (json!({"quantizer": 52}), "quantizer"),
        ] {
            let params: VideoParams = serde_json::from_value(table).unwrap();
            assert_eq!(params.check().unwrap_err().path, key);
        }
        assert!(serde_json::from_value::<VideoParams>(json!({"codec": "vp8"})).is_err());
    }

    #[test]
    fn a_codec_that_is_not_built_in_is_refused_by_key() {
        for (word, codec) in [("h264", Codec::H264), ("av1", Codec::Av1)] {
            let params: VideoParams = serde_json::from_value(json!({"codec": word})).unwrap();
            assert_eq!(params.codec, codec);
            match codec.encoder().check() {
                Ok(()) => assert_eq!(params.check(), Ok(()), "{word}"),
                Err(_) => assert_eq!(params.check().unwrap_err().path, "codec", "{word}"),
            }
        }
    }
}

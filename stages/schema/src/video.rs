//! `video`: pictures in order to a file that plays.

use marf_cache::Digest;
use marf_stage::ParamError;
use marf_video::{QUANTIZERS, RATES, Settings, check_built_in};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::check_within;

/// Parameters of `video`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct VideoParams {
    /// Pictures a second, 1 to 240.
    pub fps: u32,
    /// Quantiser of every block, 12 (finest, largest file) to 51. 6 more halve the precision, and about the
    /// bytes. The numbers are those of H.264.
    pub quantizer: u32,
}

impl Default for VideoParams {
    fn default() -> Self {
        Self {
            fps: 24,
            quantizer: 26,
        }
    }
}

impl VideoParams {
    /// Checks that this program can encode so, before anything is rendered.
    ///
    /// # Errors
    /// A number out of its range, by its key, and a build without the encoder.
    pub fn check(&self) -> Result<(), ParamError> {
        check_within("fps", self.fps, RATES)?;
        check_within("quantizer", self.quantizer, QUANTIZERS)?;
        check_built_in().map_err(|error| {
            let message = format!("{error}: build marf with it, or leave the nodes of `video` out");
            ParamError::new("", message)
        })
    }

    /// Returns the settings of the encoder.
    pub fn settings(&self) -> Settings {
        Settings {
            frames_per_second: self.fps,
            quantizer: self.quantizer,
        }
    }
}

/// Output `film` of `render`: the pictures of a path in order (PNG), which `video` encodes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Film(pub Vec<Digest>);

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
        assert!(serde_json::from_value::<VideoParams>(json!({"codec": "h264"})).is_err());
    }
}

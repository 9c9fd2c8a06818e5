//! `cameras`: a calibrated scene as a folder that other programs read.

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of `cameras`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CamerasParams {
    /// Whether photos are resampled to ideal pinhole cameras, without distortion of the lens.
    pub undistort: bool,
    /// Folder of `photos` as seen from transforms.json (`../photos`). A photo that is there in the needed
    /// form is referred to. Default: all photos are written next to transforms.json.
    pub photos_at: Option<String>,
}

impl CamerasParams {
    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        match &self.photos_at {
            Some(folder) if folder.starts_with('/') || folder.contains('\\') => Err(ParamError::new(
                "photos_at",
                format!("`{folder}` is not a relative path with `/`"),
            )),
            _ => Ok(()),
        }
    }
}

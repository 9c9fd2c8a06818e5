//! `masks`: parts of the picture that stand still while the camera moves, proposed as masks.

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of `masks`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MasksParams {
    /// Most photos of a camera that are compared, spread evenly over all.
    pub photos: u32,
}

impl Default for MasksParams {
    fn default() -> Self {
        Self { photos: 40 }
    }
}

impl MasksParams {
    /// Checks what can be checked without photos.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        match self.photos {
            0..4 => {
                let message = format!(
                    "{} photos have too few pairs to detect what does not move: use at least 4",
                    self.photos
                );
                Err(ParamError::new("photos", message))
            }
            _ => Ok(()),
        }
    }
}

/// Output `metrics` of `masks`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Every camera, by name.
    pub cameras: Vec<CameraReport>,
}

/// Findings in the photos of one camera: those of one instrument and size.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraReport {
    /// Name of its files: `<instrument>-<width>x<height>`, or the size alone.
    pub name: String,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Photos of the set.
    pub photos: u64,
    /// Pairs of photos that were compared.
    pub pairs: u32,
    /// ... between which the camera has moved.
    pub moved: u32,
    /// Share of the picture that does not move and is not masked. 0 if nothing was found or nothing can be
    /// said.
    pub share: f64,
    /// The finding, as a sentence.
    pub found: String,
}

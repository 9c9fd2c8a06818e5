//! `folds`: every photo of a small scene judged by a field that was trained without its place.

use marf_field::Device;
use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{check::check_share, scores::Scores};

/// Parameters of `folds`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FoldsParams {
    /// Scenes of fewer photos are judged by folds. Larger scenes hold out enough photos, so nothing is
    /// trained here.
    pub below: u32,
    /// Trainings, each without another part of the photos. Fewer if there are fewer places.
    pub folds: u32,
    /// Share of the steps of the node `training` that each fold is trained for. With 0.25, four folds take
    /// as long as that training.
    pub share: f64,
    /// Device that trains and renders: `auto` (a GPU if there is one, never a software adapter), `cpu`,
    /// `gpu`, or `gpu:NAME` for the adapter whose name contains NAME. Only the device that is used is part
    /// of the key.
    pub device: Device,
}

impl Default for FoldsParams {
    fn default() -> Self {
        Self {
            below: 24,
            folds: 4,
            share: 0.25,
            device: Device::default(),
        }
    }
}

impl FoldsParams {
    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        if self.folds < 2 {
            let message = format!("{} folds hold out all or nothing: use at least 2", self.folds);
            return Err(ParamError::new("folds", message));
        }
        check_share("share", self.share)
    }
}

/// Output `metrics` of `folds`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Photos with a camera.
    pub photos: u64,
    /// Scenes of fewer are judged by folds.
    pub below: u32,
    /// Result of the folds. `None` if there are enough photos, or all were taken at one place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub judged: Option<Judged>,
}

/// Result of the folds of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// On all photos, each judged by the field that was trained without it.
    #[serde(flatten)]
    pub scores: Scores,
    /// Steps of each training.
    pub steps: u64,
    /// Steps of the training whose scene is judged.
    pub steps_of_whole: u64,
    /// Every training.
    pub folds: Vec<FoldReport>,
}

/// One training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FoldReport {
    /// Photos trained on.
    pub train_photos: u64,
    /// Photos held out.
    pub held_out_photos: u64,
    /// Mean PSNR on these, dB.
    pub psnr: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn what_cannot_be_trained_is_refused_by_its_key() {
        let check = |value| serde_json::from_value::<FoldsParams>(value).unwrap().check();
        check(json!({"share": 1.0, "below": 0})).unwrap();
        for (value, path) in [
            (json!({"folds": 1}), "folds"),
            (json!({"share": 0.0}), "share"),
            (json!({"share": 1.01}), "share"),
        ] {
            assert_eq!(check(value).unwrap_err().path, path);
        }
    }
}

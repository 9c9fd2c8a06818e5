//! `evaluate`: renders of a trained field compared with photos.

use marf_field::Device;
use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{check::check_scale, scores::Scores};

/// Photos that are compared with their renders.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Which {
    /// Those held out of training.
    #[default]
    Heldout,
    /// Those trained on, as in the paper's table.
    Train,
    /// All of them.
    All,
}

/// Parameters of `evaluate`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluateParams {
    /// Photos that are compared.
    pub views: Which,
    /// Whole factor by which photos are shrunk. Default: that of the training.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<u32>,
    /// Device that trains and renders: `auto` (a GPU if there is one, never a software adapter), `cpu`,
    /// `gpu`, or `gpu:NAME` for the adapter whose name contains NAME. Only the device that is used is part
    /// of the key.
    pub device: Device,
}

impl EvaluateParams {
    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        check_scale(self.scale)
    }
}

impl Which {
    /// Returns true if it includes photos with this `is_held_out`.
    pub fn has(self, is_held_out: bool) -> bool {
        match self {
            Self::Heldout => is_held_out,
            Self::Train => !is_held_out,
            Self::All => true,
        }
    }
}

/// Output `metrics` of `evaluate`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// On the photos that were compared.
    #[serde(flatten)]
    pub scores: Scores,
    /// Factor by which photos were shrunk.
    pub scale: u32,
}

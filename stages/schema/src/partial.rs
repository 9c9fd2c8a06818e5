//! `partial`: the first steps of a training, which `train` goes on from.

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::train::TrainParams;

/// Steps that a GPU takes at once: a training that is stopped elsewhere would learn other bytes than one that is not.
pub const STEPS_AT_ONCE: u64 = 16;

/// Parameters of `partial`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PartialParams {
    /// Optimiser steps after which it stops, those of an input `state` included: a multiple of 16, or all of the training.
    pub until: u64,
    /// Longest side of the grid of pixels of each photo that it is judged by, pixels. The grid consists of
    /// the centres of boxes with an odd side.
    #[serde(default = "judged_px")]
    pub judged_px: u32,
    /// The whole training, without a time or a target. Step size, length of steps along rays and box follow
    /// its `steps`, not `until`.
    #[serde(default)]
    pub train: TrainParams,
}

/// The render of such a grid costs as much as 5 steps.
fn judged_px() -> u32 {
    128
}

impl PartialParams {
    /// Returns the first steps of a training.
    pub fn new(train: TrainParams, until: u64) -> Self {
        Self {
            until,
            judged_px: judged_px(),
            train,
        }
    }

    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        let in_train = |error: ParamError| ParamError::new(format!("train.{}", error.path), error.message);
        self.train.check().map_err(in_train)?;
        if self.train.limit().is_some() || self.train.target_psnr.is_some() {
            let message = "a training that is stopped on its way needs to know its `steps`: no `budget`, `within` or `target_psnr`";
            return Err(ParamError::new("train", message));
        }
        if self.train.warm_start {
            let message =
                "a training that is stopped on its way starts from scratch: only its own state is continued";
            return Err(ParamError::new("train.warm_start", message));
        }
        if self.train.fold.is_some() {
            let message = "a fold is trained in one piece";
            return Err(ParamError::new("train.fold", message));
        }
        let (until, steps) = (self.until, self.train.planned_steps());
        let message = match until {
            0 => format!("0 steps train nothing: use at least {}", STEPS_AT_ONCE.min(steps)),
            _ if until > steps => format!("{until} steps of a training of {steps}"),
            _ if until < steps && !until.is_multiple_of(STEPS_AT_ONCE) => {
                format!("{until} steps are not a multiple of {STEPS_AT_ONCE}: a training can only stop there")
            }
            _ if self.judged_px == 0 => {
                return Err(ParamError::new(
                    "judged_px",
                    "0 pixels show nothing: use at least 1",
                ));
            }
            _ => return Ok(()),
        };
        Err(ParamError::new("until", message))
    }
}

/// Output `reached` of `partial`: how far the training is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reached {
    /// Optimiser steps so far.
    pub until: u64,
    /// Those of the whole training.
    pub steps: u64,
    /// Mean PSNR on pixels of the photos held out, dB.
    pub psnr: f64,
    /// Photos held out.
    pub held_out_photos: u64,
    /// Longest side of the grid of these pixels, at most.
    pub judged_px: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn where_no_training_can_be_stopped_is_refused_by_its_key() {
        for (value, path, word) in [
            (json!({"until": 0}), "until", "0 steps"),
            (json!({"until": 416}), "until", "416 steps of a training of 400"),
            (json!({"until": 40}), "until", "multiple of 16"),
            (json!({"until": 48, "train": {"steps": 32}}), "until", "of 32"),
            (json!({"until": 16, "judged_px": 0}), "judged_px", "0 pixels"),
            (
                json!({"until": 16, "train": {"budget": "9s"}}),
                "train",
                "`steps`",
            ),
            (json!({"until": 16, "train": {"scale": 0}}), "train.scale", "0"),
        ] {
            let params: PartialParams = serde_json::from_value(value).unwrap();
            let error = params.check().unwrap_err();
            assert_eq!(error.path, path, "{error:?}");
            assert!(error.message.contains(word), "{error:?}");
        }
        for value in [
            json!({"until": 400}),
            json!({"until": 16}),
            json!({"until": 5, "train": {"steps": 5}}),
        ] {
            let params: PartialParams = serde_json::from_value(value).unwrap();
            params.check().unwrap();
        }
    }
}

//! `train`: a scene to a trained field, measured on held-out photos.

use marf_field::{Config, Derived, Device, Facts, Overrides, Quality};
use marf_stage::{Document, ParamError, Params};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{check_field, check_scale, scores::Scores};

pub use crate::{
    budget::{Budget, ParseBudgetError},
    memory::{Memory, ParseMemoryError},
};

/// Which photos are kept away from training, to measure on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Holdout {
    /// Those that `calibrate` holds out.
    #[default]
    Test,
    /// One in eight of the others, by place, and those that `calibrate` holds out are not looked at: for choosing parameters.
    Validation,
}

/// One of several trainings that together hold out every photo once, whole places at a time, those of `calibrate` included.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fold {
    /// Which of them, from 0.
    pub index: u32,
    /// How many there are; a scene of fewer places has fewer.
    pub count: u32,
    /// Share of the steps that are really trained, above 0 and up to 1.
    pub share: f64,
}

impl Fold {
    /// Returns the steps of this training, of a whole one of `steps`: at least 1.
    pub fn steps_of(&self, steps: u64) -> u64 {
        ((steps as f64 * self.share).round() as u64).max(1)
    }

    fn check(&self) -> Result<(), ParamError> {
        if self.count < 2 {
            let message = format!("{} folds hold out all or nothing; at least 2", self.count);
            return Err(ParamError::new("fold.count", message));
        }
        if self.index >= self.count {
            let message = format!("fold {} of {}, counted from 0", self.index, self.count);
            return Err(ParamError::new("fold.index", message));
        }
        check_share("fold.share", self.share)
    }
}

/// Checks a share of the steps of a training.
pub(crate) fn check_share(path: &str, share: f64) -> Result<(), ParamError> {
    match share > 0.0 && share <= 1.0 {
        true => Ok(()),
        false => Err(ParamError::new(
            path,
            format!("{share} of the steps; above 0, up to 1"),
        )),
    }
}

/// What decides how large the field is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// The scene and the steps.
    #[default]
    Scene,
    /// Nothing: the full base configuration of instant-ngp, to compare with.
    Fixed,
}

/// Short trainings that tell which parts of the field pay.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrialsParams {
    /// Steps of one trial, 0 for none; absent: none at quality `draft`, else all together a fifth of the training.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u64>,
    /// Least gain for which a part is kept, dB; seeds differ by about a tenth.
    pub least_gain_db: f64,
}

impl Default for TrialsParams {
    fn default() -> Self {
        Self {
            steps: None,
            least_gain_db: 0.1,
        }
    }
}

/// Parameters of `train`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrainParams {
    /// Steps, size of the photos and size of the field together.
    pub quality: Quality,
    /// Optimiser steps, instead of those of `quality`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u64>,
    /// Time to train for (`60s`, `5m`), instead of `steps`: measured once on this machine by a node `pace`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub budget: Option<Budget>,
    /// Not in this version.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target_psnr: Option<f64>,
    /// Seed of weights and rays.
    pub seed: u64,
    /// Whole factor by which photos are shrunk; absent: the least that brings them to the size of `quality`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<u32>,
    /// Memory that the training may take (`2GB`); where the photos do not fit, one pixel of every few is kept.
    pub memory: Memory,
    /// Photos that are kept away from training.
    pub holdout: Holdout,
    /// Holds out these photos instead, and trains a share of the steps: what `folds` asks for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fold: Option<Fold>,
    /// Seed with which as many training photos are drawn as there are, with replacement (a bootstrap sample).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resample: Option<u64>,
    /// What decides how large the field is.
    pub fit: Fit,
    /// Short trainings that hold back one training photo in eight, by place: width, view dependence, exposure and sky by their gain.
    pub trials: TrialsParams,
    /// Keys of the field; they win over those of the input `params`.
    pub field: Overrides,
    /// Which processor trains and renders: `auto` (a GPU where there is one, never a software adapter), `cpu`, `gpu`,
    /// or `gpu:NAME` for the adapter whose name holds NAME. Only what was opened is in the key.
    pub device: Device,
}

impl Params for TrainParams {
    const STAGE: &'static str = "train";
}

impl Fit {
    /// Returns the configuration that keys of the field are laid over.
    pub fn config(self, quality: Quality) -> Config {
        match self {
            Self::Scene => quality.config(),
            Self::Fixed => Config::fixed(),
        }
    }
}

impl TrainParams {
    /// Returns the optimiser steps of a training without a budget.
    pub fn planned_steps(&self) -> u64 {
        self.steps.unwrap_or(self.quality.steps())
    }

    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        if self.target_psnr.is_some() {
            let message = "not in this version; set `quality`, `steps` or `budget`";
            return Err(ParamError::new("target_psnr", message));
        }
        if self.steps == Some(0) {
            return Err(ParamError::new("steps", "0 steps train nothing; at least 1"));
        }
        if self.steps.is_some() && self.budget.is_some() {
            return Err(ParamError::new(
                "budget",
                "`steps` is given too; keep one of the two",
            ));
        }
        self.fold.map_or(Ok(()), |fold| fold.check())?;
        check_scale(self.scale)?;
        if !(0.0..=100.0).contains(&self.trials.least_gain_db) {
            let message = format!("{} dB; from 0 to 100", self.trials.least_gain_db);
            return Err(ParamError::new("trials.least_gain_db", message));
        }
        check_field(self.quality, self.fit, &self.field)
    }
}

/// How well a field reproduces photos that it was trained on, which is not how good it is elsewhere: the protocol of the paper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OnTraining {
    /// Photos that were compared: as many as are held out, spread evenly over those trained on.
    pub photos: u64,
    /// Mean peak signal-to-noise ratio, peak 1, dB.
    pub psnr: f64,
    /// Mean of the paper's definition, peak = largest value of the photo, dB; none where all photos are black.
    pub psnr_paper: Option<f64>,
    /// Mean structural similarity; none where all photos are smaller than its window.
    pub ssim: Option<f64>,
}

/// Output `metrics` of `train`. Nothing in it comes from a clock.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// On the photos held out.
    #[serde(flatten)]
    pub scores: Scores,
    /// On some of the photos trained on; only where those of the final metric are held out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub on_training: Option<OnTraining>,
    /// Optimiser steps.
    pub steps: u64,
    /// Rays trained.
    pub rays: u64,
    /// Samples trained.
    pub samples: u64,
    /// Mean squared error of the batches of the last eighth, sRGB in [0, 1].
    pub loss: f64,
    /// Factor by which photos were shrunk.
    pub scale: u32,
    /// One pixel of so many of each training photo was kept; absent: all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thinned: Option<u32>,
    /// Seed.
    pub seed: u64,
    /// Which photos were held out.
    pub holdout: Holdout,
    /// Which fold was held out instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fold: Option<Fold>,
    /// Photos trained on, each counted once.
    pub train_photos: u64,
    /// Photos held out.
    pub held_out_photos: u64,
    /// Ids of the photos drawn, as often as they were; only with `resample`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drawn: Option<Vec<String>>,
    /// What decided how large the field is.
    pub fit: Fit,
    /// The GPU that trained, with driver and interface; absent: the CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gpu: Option<String>,
    /// The configuration as it was used.
    pub config: Config,
    /// What the field was sized by.
    pub field: Facts,
}

impl Document for Metrics {
    const STAGE: &'static str = TrainParams::STAGE;
    const OUTPUT: &'static str = "metrics";
}

/// Output `setup` of `train`: all that a training depends on beside its scene, its seed and the draw of its photos, with
/// everything that was derived or decided on the way.
///
/// A training that reads it through its port `of` is the same training with another seed or draw.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// Optimiser steps.
    pub steps: u64,
    /// Factor by which photos are shrunk.
    pub scale: u32,
    /// One pixel of so many of each training photo is kept.
    pub kept_every: u32,
    /// Memory that the training may take.
    pub memory: Memory,
    /// Which photos are held out.
    pub holdout: Holdout,
    /// Which fold is held out instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fold: Option<Fold>,
    /// What decided how large the field is.
    pub fit: Fit,
    /// The configuration as it is used, with what trials decided.
    pub config: Config,
    /// Box and sizes.
    pub derived: Derived,
}

impl Document for Setup {
    const STAGE: &'static str = TrainParams::STAGE;
    const OUTPUT: &'static str = "setup";
}

/// Output `curve` of `train`: points in the order of steps.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Curve(pub Vec<CurvePoint>);

impl Document for Curve {
    const STAGE: &'static str = TrainParams::STAGE;
    const OUTPUT: &'static str = "curve";
}

/// A point of the training curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Optimiser steps so far.
    pub step: u64,
    /// Rays trained so far.
    pub rays: u64,
    /// Samples trained so far.
    pub samples: u64,
    /// Mean squared error of the batches since the last point, sRGB in [0, 1].
    pub loss: f64,
    /// Mean PSNR on up to three held-out photos of at most 64 pixels a side, dB.
    pub psnr: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_stage::key_params;
    use serde_json::json;

    fn params(value: serde_json::Value) -> TrainParams {
        serde_json::from_value(value).unwrap()
    }

    #[test]
    fn what_cannot_be_trained_is_refused_by_its_key() {
        for (value, path) in [
            (json!({"target_psnr": 28.0}), "target_psnr"),
            (json!({"steps": 0}), "steps"),
            (json!({"steps": 5, "budget": "60s"}), "budget"),
            (json!({"scale": 0}), "scale"),
            (
                json!({"fold": {"index": 0, "count": 1, "share": 1}}),
                "fold.count",
            ),
            (
                json!({"fold": {"index": 3, "count": 3, "share": 1}}),
                "fold.index",
            ),
            (
                json!({"fold": {"index": 0, "count": 2, "share": 0}}),
                "fold.share",
            ),
            (
                json!({"fold": {"index": 0, "count": 2, "share": 1.5}}),
                "fold.share",
            ),
            (json!({"trials": {"least_gain_db": -1.0}}), "trials.least_gain_db"),
            (json!({"field": {"levls": 3}}), "field.levls"),
            (json!({"field": {"log2_table": 99}}), "field.log2_table"),
        ] {
            let error = params(value).check().unwrap_err();
            assert!(
                error.path == path || error.message.contains("log2_table"),
                "{path}: {error:?}"
            );
        }
        params(json!({"budget": "60s", "field": {"log2_table": 16}}))
            .check()
            .unwrap();
    }

    #[test]
    fn a_fold_trains_its_share_of_the_steps_and_at_least_one() {
        let fold = |share| Fold {
            index: 0,
            count: 2,
            share,
        };
        assert_eq!(
            [1.0, 0.25, 1e-9].map(|share| fold(share).steps_of(1000)),
            [1000, 250, 1]
        );
        assert_eq!(fold(0.5).steps_of(0), 1);
    }

    #[test]
    fn a_seed_of_64_bits_is_kept_whole() {
        let (high, low) = (
            params(json!({"seed": u64::MAX})),
            params(json!({"seed": u64::from(u32::MAX)})),
        );
        assert_eq!(high.seed, u64::MAX);
        assert_ne!(key_params(&high, &[]), key_params(&low, &[]));
        let text = serde_json::to_string(&high).unwrap();
        assert_eq!(serde_json::from_str::<TrainParams>(&text).unwrap(), high);
    }
}

//! `train`: a scene to a trained field, measured on held-out photos.

mod metrics;

use marf_field::{Config, Device, Overrides, Quality, Schedule};
use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::{check_field, check_scale, check_share, check_steps};

pub use crate::{
    budget::Budget,
    memory::Memory,
    target::{Forecast, Target},
};
pub use metrics::{Curve, CurvePoint, Metrics, OnTraining, Setup, WarmStart};

/// Which photos are kept away from training, to measure on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Holdout {
    /// Those that `calibrate` holds out.
    #[default]
    Test,
    /// One in eight of the training photos, by place. Those that `calibrate` holds out are not used. For
    /// choosing parameters.
    Validation,
}

/// One of several trainings that together hold out every photo once, whole places at a time, those of `calibrate` included.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fold {
    /// Index of this fold, from 0.
    pub index: u32,
    /// Number of folds. A scene of fewer places has fewer.
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
            let message = format!("{} folds hold out all or nothing: use at least 2", self.count);
            return Err(ParamError::new("fold.count", message));
        }
        if self.index >= self.count {
            let message = format!("fold {} of {}, counted from 0", self.index, self.count);
            return Err(ParamError::new("fold.index", message));
        }
        check_share("fold.share", self.share)
    }
}

/// What decides how large the field is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// The scene and the steps.
    #[default]
    Scene,
    /// Nothing. The field is the full base configuration of instant-ngp, for comparison.
    Fixed,
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
    /// Time to train for (`60s`, `5m`), instead of `steps`: optimiser steps, not decoding or judging. The end is
    /// planned again as time passes, and the metrics hold the schedule that was run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub budget: Option<Budget>,
    /// Time of the whole wait (`5m`), instead of `steps`: from the start of the run to the end of this
    /// training, including judging and pictures. The training gets the time that everything else leaves.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub within: Option<Budget>,
    /// The schedule of a training with a budget (`[[0, 4000], [250, 3700]]`: before step 250 the end was moved to step 3,700),
    /// instead of `steps`: it repeats that training to the bit.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<Vec<[u64; 2]>>")]
    pub schedule: Option<Schedule>,
    /// Mean PSNR at which the training stops, dB. It is measured on the training photos held back for it, one
    /// in eight, by place. The training ends no later than `quality`, `steps` or `budget` says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target_psnr: Option<f64>,
    /// Seed of weights and rays.
    pub seed: u64,
    /// Whole factor by which photos are shrunk. Default: the least that brings them to 480 pixels and, with
    /// `budget` or `within`, leaves time to see a twelfth of their pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<u32>,
    /// Memory that the training may take (`2GB`). If the photos do not fit, one pixel of every few is kept.
    pub memory: Memory,
    /// Photos that are kept away from training.
    pub holdout: Holdout,
    /// Holds out these photos instead, and trains a share of the steps. `folds` sets it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fold: Option<Fold>,
    /// Most training photos, spread evenly over them. Default: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photos: Option<u64>,
    /// Most held-out photos that judge the training, spread evenly. Photos trained on then do not judge it.
    /// Default: all held-out photos, and as many of those trained on. A training with `within` chooses by its
    /// time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub judged_photos: Option<u64>,
    /// Whole factor by which the photos that judge it are shrunk. Default: `scale`, or the least that brings
    /// them to 480 pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub judged_scale: Option<u32>,
    /// Seed of a bootstrap sample: as many training photos as there are, drawn with replacement.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resample: Option<u64>,
    /// Starts from the field of this node's last finished run if the scene has only grown: new photos cost
    /// fewer steps. That field is then an input of this node, so the result depends on earlier runs. If it
    /// does not fit (other frame, other keys of the field, a box outgrown, a photo held out now that it was
    /// trained on), the training starts from scratch and says why.
    #[serde(skip_serializing_if = "is_false")]
    pub warm_start: bool,
    /// What decides how large the field is.
    pub fit: Fit,
    /// Keys of the field. They override those of the input `params`.
    pub field: Overrides,
    /// Device that trains and renders: `auto` (a GPU if there is one, never a software adapter), `cpu`,
    /// `gpu`, or `gpu:NAME` for the adapter whose name contains NAME. Only the device that is used is part
    /// of the key.
    pub device: Device,
}

// Trainings without it keep their keys.
fn is_false(flag: &bool) -> bool {
    !flag
}

/// A time that a training must keep to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Limit {
    /// Optimiser steps.
    Training(Budget),
    /// All from the start of the run to the end of the training's node.
    Wait(Budget),
}

impl Limit {
    /// Returns the time in seconds.
    pub fn seconds(self) -> f64 {
        match self {
            Self::Training(budget) | Self::Wait(budget) => budget.seconds(),
        }
    }
}

/// Part of the time of a training that an unfinished run took, approximately. It is not in the seconds of the
/// node.
pub const BEFORE_STOP: &str = "before the stop";

impl Fit {
    /// Returns the configuration that keys of the field are laid over.
    pub fn config(self) -> Config {
        match self {
            Self::Scene => Config::default(),
            Self::Fixed => Config::fixed(),
        }
    }
}

impl TrainParams {
    /// Returns the optimiser steps of a training without a budget.
    pub fn planned_steps(&self) -> u64 {
        let scheduled = self.schedule.as_ref().map(Schedule::steps);
        scheduled.or(self.steps).unwrap_or(self.quality.steps())
    }

    /// Returns the time that it may take.
    pub fn limit(&self) -> Option<Limit> {
        let training = self.budget.map(Limit::Training);
        training.or(self.within.map(Limit::Wait))
    }

    /// Returns the parameters that repeat a training with a budget to the bit, on any machine. `None` without
    /// a budget, as the parameters themselves then do so.
    pub fn repeating(&self, setup: &Setup, metrics: &Metrics) -> Option<Self> {
        self.limit()?;
        let mut field = self.field.clone();
        let batch = setup.config.batch_samples;
        if batch != self.fit.config().batch_samples {
            // The device's pace has decided it, unless a key says the same.
            let said = field.0.entry("batch_samples".to_owned());
            said.or_insert_with(|| batch.into());
        }
        // By the clock, the steps that decide on pairs are expected ones.
        let said = field.0.entry("depth_source".to_owned());
        said.or_insert_with(|| serde_json::json!(setup.config.depth_source));
        let judged_photos = self.within.map(|_| metrics.scores.views.len() as u64);
        Some(Self {
            budget: None,
            within: None,
            schedule: Some(setup.schedule()),
            field,
            scale: Some(setup.scale),
            judged_photos: self.judged_photos.or(judged_photos),
            judged_scale: self.judged_scale.or(metrics.judged_scale),
            ..self.clone()
        })
    }

    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        check_steps(self.steps)?;
        let lengths = [
            ("steps", self.steps.is_some()),
            ("budget", self.budget.is_some()),
            ("within", self.within.is_some()),
            ("schedule", self.schedule.is_some()),
        ];
        let mut given = lengths.iter().filter(|(_, is_given)| *is_given);
        if let (Some((first, _)), Some((second, _))) = (given.next(), given.next()) {
            let message = format!("`{first}` is given too: keep one of the two");
            return Err(ParamError::new(*second, message));
        }
        self.check_target()?;
        self.check_warm_start()?;
        self.fold.map_or(Ok(()), |fold| fold.check())?;
        check_scale(self.scale)?;
        self.check_judged()?;
        check_field(&self.fit.config(), &self.field)
    }
}

impl TrainParams {
    fn check_judged(&self) -> Result<(), ParamError> {
        for (key, photos) in [("photos", self.photos), ("judged_photos", self.judged_photos)] {
            if photos == Some(0) {
                return Err(ParamError::new(key, "0 photos measure nothing: use at least 1"));
            }
        }
        check_scale(self.judged_scale).map_err(|error| ParamError::new("judged_scale", error.message))
    }

    /// A child training has no last run of its own.
    fn check_warm_start(&self) -> Result<(), ParamError> {
        let other = [
            ("fold", self.fold.is_some()),
            ("resample", self.resample.is_some()),
        ];
        match other.iter().find(|(_, is_given)| self.warm_start && *is_given) {
            Some((key, _)) => Err(ParamError::new(
                "warm_start",
                format!("`{key}` is given too: keep one of the two"),
            )),
            None => Ok(()),
        }
    }

    fn check_target(&self) -> Result<(), ParamError> {
        let Some(psnr) = self.target_psnr else {
            return Ok(());
        };
        if !(psnr > 0.0 && psnr <= 100.0) {
            return Err(ParamError::new(
                "target_psnr",
                format!("{psnr} dB is not above 0 and at most 100"),
            ));
        }
        let other = [
            ("fold", self.fold.is_some()),
            ("resample", self.resample.is_some()),
            ("holdout", self.holdout != Holdout::Test),
        ];
        match other.iter().find(|(_, is_given)| *is_given) {
            Some((key, _)) => Err(ParamError::new(
                "target_psnr",
                format!("with `{key}` no photo is left to measure the target: keep one of the two"),
            )),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests;

use marf_cache::ContentHash;
use marf_field::{Config, Device, Overrides, Quality};
use marf_scene::Scene;
use marf_stage::{Ctx, Inputs, ParamError, StageError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Budget, Memory, TrainError};

/// Which photos are kept away from training, to measure on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(rename_all = "snake_case")]
pub enum Holdout {
    /// Those that `calibrate` holds out.
    #[default]
    Test,
    /// Every 8th of the others, and those that `calibrate` holds out are not looked at: for choosing parameters.
    Validation,
}

/// What decides how large the field is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// The scene and the steps.
    #[default]
    Scene,
    /// Nothing: the full base configuration of instant-ngp, to compare with.
    Fixed,
}

/// Short trainings that tell which parts of the field pay.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, ContentHash)]
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
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema, ContentHash)]
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
    /// Seed with which as many training photos are drawn as there are, with replacement (a bootstrap sample).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resample: Option<u64>,
    /// What decides how large the field is.
    pub fit: Fit,
    /// Short trainings on every 8th training photo held back: width, view dependence, exposure and sky by their gain.
    pub trials: TrialsParams,
    /// Keys of the field; they win over those of the input `params`.
    pub field: Overrides,
    /// Which processor trains and renders: `auto` (a GPU where there is one, never a software adapter), `cpu`, `gpu`,
    /// or `gpu:NAME` for the adapter whose name holds NAME. Only what was opened is in the key.
    #[content_hash(skip)]
    pub device: Device,
}

impl TrainParams {
    /// Checks what can be checked without a scene.
    pub(crate) fn check(&self) -> Result<(), ParamError> {
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
        check_scale(self.scale)?;
        if !(0.0..=100.0).contains(&self.trials.least_gain_db) {
            let message = format!("{} dB; from 0 to 100", self.trials.least_gain_db);
            return Err(ParamError::new("trials.least_gain_db", message));
        }
        check_field(self.quality, self.fit, &self.field)
    }
}

pub(crate) fn check_scale(scale: Option<u32>) -> Result<(), ParamError> {
    match scale {
        Some(0) => Err(ParamError::new(
            "scale",
            "photos cannot be shrunk by 0; 1 keeps them",
        )),
        _ => Ok(()),
    }
}

pub(crate) fn check_field(quality: Quality, fit: Fit, field: &Overrides) -> Result<(), ParamError> {
    let checked = field.over(&base(quality, fit));
    checked.map(|_| ()).map_err(|error| {
        let path = format!("field.{}", error.key);
        ParamError::new(path.trim_end_matches('.'), error.message)
    })
}

/// Output `params` of `tune`: what it chose.
#[derive(Debug, Default, Deserialize)]
struct Chosen {
    field: Overrides,
}

/// Returns the keys that are set: those of the input `params`, under `field`.
pub(crate) fn keys(ctx: &Ctx<'_>, inputs: &Inputs, field: &Overrides) -> Result<Overrides, StageError> {
    let chosen = match inputs.optional("params") {
        Some(digest) => serde_json::from_slice::<Chosen>(&ctx.get(digest)?)
            .map_err(|error| TrainError::Params(error.to_string()))?,
        None => Chosen::default(),
    };
    Ok(chosen.field.with(field))
}

/// Returns the configuration that keys are laid over; `steps` are those the training is expected to take.
pub(crate) fn config(keys: &Overrides, quality: Quality, fit: Fit, steps: u64) -> Result<Config, StageError> {
    let base = Config {
        steps: Some(steps.max(1)),
        ..base(quality, fit)
    };
    let config = keys.over(&base);
    Ok(config.map_err(|error| TrainError::Params(error.to_string()))?)
}

fn base(quality: Quality, fit: Fit) -> Config {
    match fit {
        Fit::Scene => quality.config(),
        Fit::Fixed => Config::fixed(),
    }
}

/// Returns `scale`, or the least whole factor that brings every photo to the size worth training on.
pub(crate) fn scale(scale: Option<u32>, quality: Quality, scene: &Scene) -> u32 {
    let sides = scene
        .frames
        .iter()
        .map(|frame| frame.camera.width.max(frame.camera.height));
    let longest = sides.max().unwrap_or(1);
    scale.unwrap_or_else(|| longest.div_ceil(quality.longest_side_px()).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_cache::digest_of;
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
    fn a_seed_of_64_bits_is_kept_whole() {
        let (high, low) = (
            params(json!({"seed": u64::MAX})),
            params(json!({"seed": u64::from(u32::MAX)})),
        );
        assert_eq!(high.seed, u64::MAX);
        assert_ne!(digest_of(&high), digest_of(&low));
        let text = serde_json::to_string(&high).unwrap();
        assert_eq!(serde_json::from_str::<TrainParams>(&text).unwrap(), high);
    }

    #[test]
    fn photos_are_shrunk_by_the_least_factor_that_fits() {
        let mut scene = Scene::default();
        assert_eq!(scale(None, Quality::Draft, &scene), 1);
        for (width, height, factor) in [(480, 360, 1), (481, 10, 2), (1440, 1920, 4), (10, 961, 3)] {
            scene.frames = vec![marf_scene::Frame {
                id: String::new(),
                file: String::new(),
                image: marf_cache::Digest::of(b""),
                camera: marf_scene::Camera::pinhole(width, height, 1.0),
                cam_from_world: marf_scene::Pose::identity(),
                held_out: false,
                error_px: None,
            }];
            assert_eq!(scale(None, Quality::Draft, &scene), factor, "{width} x {height}");
            assert_eq!(scale(Some(7), Quality::Draft, &scene), 7);
        }
    }
}

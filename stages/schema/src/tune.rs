//! `tune`: search of the field's hyper-parameters.

use std::collections::BTreeMap;

use marf_field::{Device, Overrides, Quality};
use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{
    check::{check_field, check_scale, check_steps, check_within},
    train::Fit,
};

/// How trials are compared.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Search {
    /// By successive halving: all are trained for a ninth of the steps, the best third continues to a third
    /// of them. The best third of these continues to the end, together with the defaults.
    #[default]
    Halving,
    /// All are trained to the same step, as in the paper.
    Random,
}

/// Parameters of `tune`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TuneParams {
    /// How trials are compared.
    pub search: Search,
    /// Parameter sets that are tried, the defaults among them.
    pub trials: u32,
    /// With `halving`, one trial in this many continues after each rung, 2 to 10. The rungs are at 1/eta²
    /// and 1/eta of the steps.
    pub eta: u32,
    /// Seed of the draws, and of every trial's weights and rays.
    pub seed: u64,
    /// Size of the photos and of the field, before drawn keys override it.
    pub quality: Quality,
    /// Optimiser steps. With `halving`: of the training that is tuned, default those of `quality`. With
    /// `random`: of a trial, default a quarter of those.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u64>,
    /// Whole factor by which photos are shrunk. Default: the least that brings them to 480 pixels, with
    /// `random` to half of that. With `halving` all but the last rung are judged by photos of at most 128
    /// pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<u32>,
    /// Keys of the field for all trials, including the defaults. Drawn keys override them. The chosen keys
    /// include them.
    pub field: Overrides,
    /// Least gain over the defaults for which a trial is chosen, dB. The gain must also exceed the difference
    /// between seeds.
    pub least_gain_db: f64,
    /// Search space: key = `{ log = [low, high] }`, `{ int = [low, high] }` or `{ choice = [..] }`. A choice
    /// that is a table sets its own keys, and its key here is only a name.
    pub space: Space,
    /// Device that trains and renders: `auto` (a GPU if there is one, never a software adapter), `cpu`,
    /// `gpu`, or `gpu:NAME` for the adapter whose name contains NAME. Only the device that is used is part
    /// of the key.
    pub device: Device,
}

impl Default for TuneParams {
    fn default() -> Self {
        Self {
            search: Search::default(),
            trials: 9,
            eta: 3,
            seed: 0,
            quality: Quality::default(),
            steps: None,
            scale: None,
            field: Overrides::default(),
            least_gain_db: 0.1,
            space: default_space(),
            device: Device::default(),
        }
    }
}

/// Most trials. A larger number is taken for a mistake.
const MAX_TRIALS: u32 = 1000;

impl TuneParams {
    /// Returns the steps of the longest training.
    pub fn horizon(&self) -> u64 {
        let whole = self.quality.steps();
        self.steps.unwrap_or(match self.search {
            Search::Halving => whole,
            Search::Random => (whole / 4).max(1),
        })
    }

    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        check_within("trials", self.trials, 1..=MAX_TRIALS)?;
        check_steps(self.steps)?;
        check_scale(self.scale)?;
        check_within("eta", self.eta, 2..=10)?;
        check_within("least_gain_db", self.least_gain_db, 0.0..=100.0)?;
        check_field(&Fit::Scene.config(), &self.field)?;
        for (key, range) in &self.space {
            let path = format!("space.{key}");
            if let Some(fault) = range.fault() {
                return Err(ParamError::new(path, fault));
            }
            for value in range.extremes() {
                let set = match value {
                    serde_json::Value::Object(table) => Overrides(table.into_iter().collect()),
                    value => Overrides([(key.clone(), value)].into()),
                };
                let checked = self.field.with(&set).over(&Fit::Scene.config());
                checked.map_err(|error| ParamError::new(path.as_str(), error.message))?;
            }
        }
        Ok(())
    }
}

/// Search range of each key.
pub type Space = BTreeMap<String, Range>;

/// Values from which one is drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Range {
    /// From the first to the second number, evenly by factor, rounded to three digits.
    Log([f64; 2]),
    /// A whole number from the first to the second, both included.
    Int([i64; 2]),
    /// One of these. A table sets several keys at once.
    Choice(Vec<Value>),
}

/// Returns the default search space: step size, length of a step along a ray, features an entry, and factors
/// on the scene's table size and finest level, from which the number of levels follows.
pub fn default_space() -> Space {
    let features = [4, 2].map(Value::from);
    Space::from([
        ("learning_rate".to_owned(), Range::Log([0.005, 0.05])),
        ("log2_table_shift".to_owned(), Range::Int([-1, 1])),
        ("finest_factor".to_owned(), Range::Log([0.5, 2.0])),
        ("features".to_owned(), Range::Choice(features.into())),
        ("cone".to_owned(), Range::Log([0.02, 0.08])),
    ])
}

impl Range {
    /// Returns both ends, or every choice: values that all must be allowed.
    fn extremes(&self) -> Vec<Value> {
        match self {
            Self::Log(ends) => ends.iter().copied().map(Value::from).collect(),
            Self::Int(ends) => ends.iter().copied().map(Value::from).collect(),
            Self::Choice(values) => values.clone(),
        }
    }

    /// Returns the fault of the range itself.
    fn fault(&self) -> Option<String> {
        match self {
            Self::Log([low, high]) => {
                let fine = *low > 0.0 && low <= high && (high / low).is_finite();
                (!fine).then(|| format!("`log = [{low}, {high}]` must not fall, and be above 0 and finite"))
            }
            Self::Int([low, high]) => (low > high).then(|| format!("`int = [{low}, {high}]` must not fall")),
            Self::Choice(values) => values.is_empty().then(|| "`choice` is empty".to_owned()),
        }
    }
}

/// Output `params` of `tune`: the keys that the chosen trial had set.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct BestParams {
    /// Keys of the field.
    pub field: Overrides,
}

/// Output `trials` of `tune`: every trial, by number.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Trials(pub Vec<Trial>);

/// A row of the output `trials`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Its number. 0 is the defaults.
    pub trial: u32,
    /// 1 is the best PSNR of those that went furthest. Equals are ordered by number.
    pub rank: u32,
    /// Optimiser steps that it was trained for.
    pub steps: u64,
    /// Longest side of the grid of pixels of each photo that it was judged by. Absent if it was judged by all
    /// pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub judged_px: Option<u32>,
    /// Mean PSNR on the validation photos after these steps, dB.
    pub psnr: f64,
    /// The paper's definition. Like SSIM it is absent for a trial that was stopped early.
    pub psnr_paper: Option<f64>,
    /// Mean SSIM.
    pub ssim: Option<f64>,
    /// Keys that were set.
    pub params: Overrides,
}

/// Output `scatter`: how much of a difference the seed alone makes, and what was decided with it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scatter {
    /// PSNR of the defaults with the seed and with the next one, dB.
    pub psnr: [f64; 2],
    /// PSNR of the best trial with the same two seeds, dB. Absent if it was not far enough ahead for a second
    /// look.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub best_psnr: Option<[f64; 2]>,
    /// PSNR difference between seeds, dB, the larger of both: gains below it may be chance.
    pub difference_db: f64,
    /// Gain of the best trial over the defaults, dB, in the mean over the seeds that both were trained with.
    pub best_minus_default_db: f64,
    /// Number of the trial whose keys are the output `params`. 0: the defaults.
    pub chosen: u32,
    /// Why, in one sentence.
    pub decision: String,
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn ranges_that_cannot_be_drawn_from_say_why() {
        for (range, word) in [
            (Range::Log([0.0, 1.0]), "above 0"),
            (Range::Log([2.0, 1.0]), "above 0"),
            (Range::Log([f64::NAN, 1.0]), "above 0"),
            (Range::Log([1.0, f64::INFINITY]), "finite"),
            (Range::Int([3, 2]), "must not fall"),
            (Range::Choice(vec![]), "empty"),
        ] {
            assert!(range.fault().unwrap().contains(word), "{range:?}");
        }
        assert!(default_space().values().all(|range| range.fault().is_none()));
    }

    #[test]
    fn what_cannot_be_searched_is_refused_by_its_key() {
        for (table, key) in [
            (json!({"trials": 0}), "trials"),
            (json!({"trials": 1001}), "trials"),
            (json!({"steps": 0}), "steps"),
            (json!({"eta": 1}), "eta"),
            (json!({"eta": 11}), "eta"),
            (json!({"least_gain_db": -0.1}), "least_gain_db"),
            (json!({"field": {"lerning_rate": 0.1}}), "field.lerning_rate"),
            (
                json!({"space": {"lerning_rate": {"log": [0.1, 0.2]}}}),
                "space.lerning_rate",
            ),
            (
                json!({"space": {"log2_table_shift": {"int": [-1, 9]}}}),
                "space.log2_table_shift",
            ),
            (json!({"space": {"cone": {"log": [0.2, 0.1]}}}), "space.cone"),
            (
                json!({"space": {"layout": {"choice": [{"levls": 8}]}}}),
                "space.layout",
            ),
        ] {
            let params: TuneParams = serde_json::from_value(table).unwrap();
            let error = params.check().unwrap_err();
            assert_eq!(error.path, key, "{error:?}");
        }
        TuneParams::default().check().unwrap();
    }
}

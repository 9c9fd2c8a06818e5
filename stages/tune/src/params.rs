use marf_cache::ContentHash;
use marf_field::{Device, Overrides, Quality};
use marf_scene::Scene;
use marf_stage::{Ctx, Define, Expand, Inputs, NodeSpec, Outputs, ParamError, Port, Stage, StageError, Work};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::{
    draw::{Space, default_space, draw},
    reduce::reduce,
};

/// Parameters of `tune`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, ContentHash)]
#[serde(default, deny_unknown_fields)]
pub struct TuneParams {
    /// Parameter sets that are tried, the defaults among them.
    pub trials: u32,
    /// Seed of the draws, and of every trial's weights and rays.
    pub seed: u64,
    /// Size of the photos and of the field that the draws are laid over.
    pub quality: Quality,
    /// Optimiser steps of a trial; absent: a quarter of those of `quality`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u64>,
    /// Whole factor by which photos are shrunk; absent: the least that brings them to half the size of `quality`,
    /// for most of a trial's time goes into rendering the photos it is judged by.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<u32>,
    /// What may be tried: key = `{ log = [low, high] }`, `{ int = [low, high] }` or `{ choice = [..] }`; a choice that
    /// is a table sets its own keys, and its name here is only a name.
    pub space: Space,
    /// Which processor trains and renders: `auto` (a GPU where there is one, never a software adapter), `cpu`, `gpu`,
    /// or `gpu:NAME` for the adapter whose name holds NAME. Only what was opened is in the key.
    #[content_hash(skip)]
    pub device: Device,
}

impl Default for TuneParams {
    fn default() -> Self {
        Self {
            trials: 6,
            seed: 0,
            quality: Quality::default(),
            steps: None,
            scale: None,
            space: default_space(),
            device: Device::default(),
        }
    }
}

/// Most trials; beyond it a number is a slip.
const MAX_TRIALS: u32 = 1000;

/// Tries parameter sets on validation photos and keeps the best.
///
/// The photos that `calibrate` holds out are never looked at: every 8th training photo judges the trials.
#[derive(Debug)]
pub struct Tune {
    params: TuneParams,
}

impl Define for Tune {
    type Params = TuneParams;
    const NAME: &'static str = "tune";
    const ABOUT: &'static str = "Tries parameters of the field at random and keeps the best";
    const VERSION: u32 = 1;
    const PORTS: &'static [Port] = &[Port::required("input", "scene")];
    const OUTPUTS: &'static [&'static str] = &["params", "trials", "scatter"];

    fn new(params: TuneParams) -> Result<Self, ParamError> {
        check(&params)?;
        Ok(Self { params })
    }
}

fn check(params: &TuneParams) -> Result<(), ParamError> {
    if !(1..=MAX_TRIALS).contains(&params.trials) {
        let message = format!(
            "{} trials; from 1, which is the defaults, to {MAX_TRIALS}",
            params.trials
        );
        return Err(ParamError::new("trials", message));
    }
    for (key, value) in [("steps", params.steps), ("scale", params.scale.map(u64::from))] {
        if value == Some(0) {
            return Err(ParamError::new(key, "0 gives nothing; at least 1"));
        }
    }
    for (key, range) in &params.space {
        let path = format!("space.{key}");
        if let Some(fault) = range.fault() {
            return Err(ParamError::new(path, fault));
        }
        for value in range.extremes() {
            let set = match value {
                serde_json::Value::Object(table) => Overrides(table.into_iter().collect()),
                value => Overrides([(key.clone(), value)].into()),
            };
            let checked = set.over(&params.quality.config());
            checked.map_err(|error| ParamError::new(path.as_str(), error.message))?;
        }
    }
    Ok(())
}

impl Stage for Tune {
    fn params(&self) -> &dyn ContentHash {
        &self.params
    }

    fn work(&self) -> Work<'_> {
        Work::Expand(self)
    }
}

impl Expand for Tune {
    fn expand(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
        let params = TuneParams {
            scale: Some(self.scale(ctx, inputs)?),
            ..self.params.clone()
        };
        let params = &params;
        let trials = (0..params.trials).map(|trial| {
            let set = draw(&params.space, params.seed, trial);
            node(params, format!("trial-{trial:02}"), params.seed, &set, inputs)
        });
        let again = params.seed.wrapping_add(1);
        let scatter = node(
            params,
            "scatter-00".to_owned(),
            again,
            &Overrides::default(),
            inputs,
        );
        Ok(trials.chain([scatter]).collect())
    }

    fn reduce(&self, ctx: &Ctx<'_>, _inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        reduce(ctx, &self.params, children)
    }
}

impl Tune {
    fn scale(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<u32, StageError> {
        if let Some(scale) = self.params.scale {
            return Ok(scale);
        }
        let scene = Scene::decode(&ctx.get(inputs.required("scene")?)?)
            .map_err(|error| StageError::new(error.to_string()))?;
        let cameras = scene.frames.iter().map(|frame| &frame.camera);
        let longest = cameras
            .map(|camera| camera.width.max(camera.height))
            .max()
            .unwrap_or(1);
        let side_px = (self.params.quality.longest_side_px() / 2).max(1);
        Ok(longest.div_ceil(side_px).max(1))
    }
}

fn node(params: &TuneParams, name: String, seed: u64, set: &Overrides, inputs: &Inputs) -> NodeSpec {
    let steps = params.steps.unwrap_or((params.quality.steps() / 4).max(1));
    let mut table = json!({
        "quality": params.quality, "steps": steps, "seed": seed, "holdout": "validation", "field": set,
        "scale": params.scale, "trials": {"steps": 0},
    });
    if params.device != Device::default() {
        table["device"] = json!(params.device);
    }
    NodeSpec {
        name,
        stage: "train".to_owned(),
        params: table,
        inputs: inputs.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::{Camera, Frame, Pose};
    use marf_stage::harness::Harness;

    fn asked(table: serde_json::Value) -> Vec<NodeSpec> {
        let harness = Harness::default();
        let stage = Tune::new(serde_json::from_value(table).unwrap()).unwrap();
        let frame = Frame {
            id: String::new(),
            file: String::new(),
            image: marf_cache::Digest::of(b""),
            camera: Camera::pinhole(640, 480, 500.0),
            cam_from_world: Pose::identity(),
            held_out: false,
            error_px: None,
        };
        let scene = Scene {
            frames: vec![frame],
            ..Scene::default()
        };
        let digest = harness.put(&scene.encode().unwrap());
        let inputs = Inputs([("scene".to_owned(), digest)].into());
        stage.expand(&harness.ctx(), &inputs).unwrap()
    }

    #[test]
    fn more_trials_keep_the_first_ones_and_the_scatter() {
        let (three, six) = (asked(json!({"trials": 3})), asked(json!({"trials": 6})));
        assert_eq!(three[..3], six[..3]);
        assert_eq!(three[3], six[6]);
        assert_eq!(
            (six[5].name.as_str(), six[6].name.as_str()),
            ("trial-05", "scatter-00")
        );
    }

    #[test]
    fn trials_are_judged_on_validation_photos_and_the_scatter_has_another_seed() {
        let nodes = asked(json!({"trials": 2, "seed": u64::MAX, "scale": 3}));
        for node in &nodes {
            assert_eq!(
                (node.stage.as_str(), &node.params["holdout"]),
                ("train", &json!("validation"))
            );
            assert_eq!(node.params["scale"], 3);
        }
        let seeds: Vec<_> = nodes
            .iter()
            .map(|node| node.params["seed"].as_u64().unwrap())
            .collect();
        assert_eq!(seeds, [u64::MAX, u64::MAX, 0]);
        assert_eq!(asked(json!({}))[0].params["scale"], 3, "640 px to at most 240");
        assert_eq!(nodes[0].params["field"], json!({}));
        assert_eq!(nodes[0].params["field"], nodes[2].params["field"]);
    }

    #[test]
    fn what_cannot_be_searched_is_refused_by_its_key() {
        for (table, key) in [
            (json!({"trials": 0}), "trials"),
            (json!({"trials": 1001}), "trials"),
            (json!({"steps": 0}), "steps"),
            (
                json!({"space": {"lerning_rate": {"log": [0.1, 0.2]}}}),
                "space.lerning_rate",
            ),
            (
                json!({"space": {"log2_table": {"int": [14, 99]}}}),
                "space.log2_table",
            ),
            (json!({"space": {"cone": {"log": [0.2, 0.1]}}}), "space.cone"),
            (
                json!({"space": {"layout": {"choice": [{"levls": 8}]}}}),
                "space.layout",
            ),
        ] {
            let error = Tune::new(serde_json::from_value(table).unwrap()).unwrap_err();
            assert_eq!(error.path, key, "{error:?}");
        }
        Tune::new(TuneParams::default()).unwrap();
    }
}

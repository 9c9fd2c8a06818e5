//! `tune`: random search of the field's hyper-parameters; every trial is a `train` node.
//!
//! What a trial sets depends on the seed, its number and the key alone, so more trials, or another key, leave the
//! earlier trials as they were.

mod reduce;
mod sampling;

use marf_field::Overrides;
use marf_schema::{
    output::SCENE,
    train::{Holdout, TrainParams, TrialsParams},
    tune::{BestParams, Scatter, Trials, TuneParams},
};
use marf_stage::{
    ChildStage, Ctx, Define, Document, Expand, Inputs, NodeSpec, Outputs, ParamError, Params, Port, Stage,
    StageError, Work,
};

use crate::{child::child_stage, io::read_scene, settings::scale_to};
use reduce::reduce;
use sampling::sample_params;

/// Trains with drawn parameter sets and keeps the best.
///
/// Trials are measured on one training photo in eight, by place; those that `calibrate` holds out are never read.
#[derive(Debug)]
pub struct Tune {
    params: TuneParams,
}

impl Define for Tune {
    type Params = TuneParams;
    const NAME: &'static str = TuneParams::STAGE;
    const ABOUT: &'static str = "Tries parameters of the field at random and keeps the best";
    const VERSION: u32 = 3;
    const PORTS: &'static [Port] = &[Port::required("input", SCENE)];
    const OUTPUTS: &'static [&'static str] = &[BestParams::OUTPUT, Trials::OUTPUT, Scatter::OUTPUT];

    fn new(params: TuneParams) -> Result<Self, ParamError> {
        params.check()?;
        Ok(Self { params })
    }
}

impl Stage for Tune {
    fn params(&self) -> serde_json::Value {
        marf_stage::key_params(&self.params, &["device"])
    }

    fn work(&self) -> Work<'_> {
        Work::Expand(self)
    }
}

impl Expand for Tune {
    fn children(&self) -> Vec<ChildStage> {
        vec![child_stage(&trial(
            &self.params,
            self.params.seed,
            Overrides::default(),
        ))]
    }

    fn expand(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
        let side_px = self.params.quality.longest_side_px() / 2;
        let scale = match self.params.scale {
            Some(scale) => scale,
            None => scale_to(side_px, &read_scene(ctx, inputs)?),
        };
        let params = &TuneParams {
            scale: Some(scale),
            ..self.params.clone()
        };
        let mut nodes = Vec::with_capacity(params.trials as usize + 1);
        for trial in 0..params.trials {
            let set = sample_params(&params.space, params.seed, trial);
            let train = self::trial(params, params.seed, set);
            nodes.push(NodeSpec::of(format!("trial-{trial:02}"), &train, inputs)?);
        }
        let again = params.seed.wrapping_add(1);
        let train = trial(params, again, Overrides::default());
        nodes.push(NodeSpec::of("scatter-00", &train, inputs)?);
        Ok(nodes)
    }

    fn reduce(&self, ctx: &Ctx<'_>, _inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        reduce(ctx, &self.params, children)
    }
}

/// Returns the training of one parameter set, judged on validation photos.
fn trial(params: &TuneParams, seed: u64, set: Overrides) -> TrainParams {
    TrainParams {
        quality: params.quality,
        steps: Some(params.steps.unwrap_or((params.quality.steps() / 4).max(1))),
        seed,
        scale: params.scale,
        holdout: Holdout::Validation,
        trials: TrialsParams {
            steps: Some(0),
            ..TrialsParams::default()
        },
        field: set,
        device: params.device.clone(),
        ..TrainParams::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::{Camera, Frame, Pose, Scene};
    use marf_stage::harness::Harness;
    use serde_json::json;

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
            mask: None,
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

    /// The keys of trials follow from these: other parameters would train all stores anew.
    #[test]
    fn a_trial_has_the_parameters_it_always_had() {
        let device = json!("gpu:a100");
        for (table, given) in [
            (
                json!({"trials": 2, "scale": 3}),
                json!({"scale": 3, "steps": 100}),
            ),
            (
                json!({"trials": 2, "seed": 7, "steps": 40, "quality": "best", "device": device}),
                json!({"seed": 7, "steps": 40, "quality": "best", "scale": 1, "device": device}),
            ),
        ] {
            let mut written = json!({"holdout": "validation", "trials": {"steps": 0}});
            let keys = given.as_object().unwrap().clone();
            written.as_object_mut().unwrap().extend(keys);
            let written: TrainParams = serde_json::from_value(written).unwrap();
            let node = asked(table).swap_remove(0);
            let bound: TrainParams = serde_json::from_value(node.params).unwrap();
            assert_eq!(bound, written);
        }
    }
}

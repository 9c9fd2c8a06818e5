//! Search (`tune`) of the field's hyper-parameters by successive halving, or at random. Every training is a node.
//!
//! The values of a trial depend on the seed, its number and the key alone. More trials, or another key, leave the earlier trials as they
//! were.

mod halving;
mod judged;
mod reduce;
mod sampling;
mod trainings;

use marf_field::{Overrides, Quality};
use marf_schema::{
    output::SCENE,
    partial::PartialParams,
    train::Metrics,
    tune::{BestParams, Scatter, Search, Trials, TuneParams},
};
use marf_stage::{
    ChildStage, Ctx, Document, Expand, Inputs, NodeSpec, Outputs, Port, StageError, Threads, stage,
};

use crate::{child::Child, io::read_scene, settings::scale_to};
use halving::next_rung;
use judged::{Standing, TrialScore, miscounted};
use reduce::{is_ahead, reduce};
use sampling::sample_params;
use trainings::{scatter, train_of};

/// Trains with drawn parameter sets and keeps the best, or the defaults if the scatter explains the difference.
///
/// Trials are measured on one training photo in eight, by place. Those that `calibrate` holds out are never read.
#[derive(Debug)]
pub struct Tune {
    params: TuneParams,
}

stage! {
    Tune { params: TuneParams },
    Expand,
    Threads::One,
    about: "tries parameters of the field and keeps the best, or the defaults",
    version: 8,
    ports: [Port::required("input", SCENE)],
    outputs: [BestParams::OUTPUT, Trials::OUTPUT, Scatter::OUTPUT],
    without: "device",
}

impl Expand for Tune {
    fn children(&self) -> Vec<ChildStage> {
        let train = train_of(&self.params, self.params.seed, &Overrides::default());
        let until = train.planned_steps();
        match self.params.search {
            Search::Random => vec![ChildStage::new(&train)],
            Search::Halving => vec![
                ChildStage::new(&train),
                ChildStage::new(&PartialParams::new(train, until)),
            ],
        }
    }

    fn expand(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
        let params = &self.with_scale(ctx, inputs)?;
        match params.search {
            Search::Random => all_at_once(params, inputs),
            Search::Halving => next_rung(ctx, params, inputs, &[]),
        }
    }

    fn further(&self, ctx: &Ctx<'_>, inputs: &Inputs, done: &[Outputs]) -> Result<Vec<NodeSpec>, StageError> {
        let params = &self.with_scale(ctx, inputs)?;
        match params.search {
            Search::Random => confirmation(params, inputs, &standing_at_once(ctx, params, done)?),
            Search::Halving => match next_rung(ctx, params, inputs, done)? {
                none if none.is_empty() => {
                    confirmation(params, inputs, &halving::standing(ctx, params, done)?)
                }
                nodes => Ok(nodes),
            },
        }
    }

    fn reduce(&self, ctx: &Ctx<'_>, _inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        let params = &self.params;
        let standing = match params.search {
            Search::Random => standing_at_once(ctx, params, children)?,
            Search::Halving => halving::standing(ctx, params, children)?,
        };
        reduce(ctx, params, &standing)
    }
}

impl Tune {
    /// Returns the parameters with the factor by which photos are shrunk: to the usual size, or half of it where all
    /// trials are trained to the end.
    fn with_scale(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<TuneParams, StageError> {
        let side_px = match self.params.search {
            Search::Halving => Quality::LONGEST_SIDE_PX,
            Search::Random => Quality::LONGEST_SIDE_PX / 2,
        };
        let scale = match self.params.scale {
            Some(scale) => scale,
            None => scale_to(side_px, &read_scene(ctx, inputs)?),
        };
        Ok(TuneParams {
            scale: Some(scale),
            ..self.params.clone()
        })
    }
}

/// Returns the trainings of a random search.
fn all_at_once(params: &TuneParams, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
    let mut nodes = Vec::with_capacity(params.trials as usize + 1);
    for trial in 0..params.trials {
        let set = sample_params(&params.space, params.seed, trial);
        let train = train_of(params, params.seed, &set);
        nodes.push(NodeSpec::new(format!("trial-{trial:02}"), &train, inputs)?);
    }
    nodes.push(scatter(params, 0, inputs)?);
    Ok(nodes)
}

/// Returns the training of the best trial with another seed, if it beats the defaults and has not run with another seed yet. The best of
/// many is the luckiest, too.
fn confirmation(
    params: &TuneParams,
    inputs: &Inputs,
    standing: &Standing,
) -> Result<Vec<NodeSpec>, StageError> {
    if standing.best_with_other_seed.is_some() || !is_ahead(params, standing) {
        return Ok(Vec::new());
    }
    Ok(vec![scatter(params, standing.best(), inputs)?])
}

/// Reads how the trials of a random search came out.
fn standing_at_once(
    ctx: &Ctx<'_>,
    params: &TuneParams,
    children: &[Outputs],
) -> Result<Standing, StageError> {
    let count = params.trials as usize + 1;
    let (trained, rest) = children
        .split_at_checked(count)
        .ok_or_else(|| miscounted(params, children.len()))?;
    let trials = Child::numbered("trial", trained);
    let judged: Result<Vec<TrialScore>, StageError> = trials
        .iter()
        .map(|trial| Ok(trial.read::<Metrics>(ctx)?.into()))
        .collect();
    let mut judged = judged?;
    let again = judged.pop().ok_or_else(|| miscounted(params, 0))?;
    Standing::new(ctx, params, judged, again, rest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::{Camera, Frame, Pose, Scene};
    use marf_schema::train::TrainParams;
    use marf_stage::Define;
    use marf_stage::harness::Harness;
    use serde_json::json;

    fn asked(table: serde_json::Value) -> Vec<NodeSpec> {
        let harness = Harness::default();
        let stage = Tune::new(serde_json::from_value(table).unwrap()).unwrap();
        let frame = Frame {
            id: String::new(),
            file: String::new(),
            image: marf_cache::Digest::from_content(b""),
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

    fn random(mut table: serde_json::Value) -> Vec<NodeSpec> {
        table["search"] = json!("random");
        asked(table)
    }

    #[test]
    fn more_trials_keep_the_first_ones_and_the_scatter() {
        let (three, six) = (random(json!({"trials": 3})), random(json!({"trials": 6})));
        assert_eq!(three[..3], six[..3]);
        assert_eq!(three[3], six[6]);
        assert_eq!(
            (six[5].name.as_str(), six[6].name.as_str()),
            ("trial-05", "scatter-00")
        );
    }

    #[test]
    fn trials_are_judged_on_validation_photos_and_the_scatter_has_another_seed() {
        let nodes = random(json!({"trials": 2, "seed": u64::MAX, "scale": 3}));
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
        assert_eq!(random(json!({}))[0].params["scale"], 3, "640 px to at most 240");
        assert_eq!(
            asked(json!({}))[0].params["train"]["scale"],
            2,
            "640 px to at most 480"
        );
        assert_eq!(nodes[0].params["field"], json!({}));
        assert_eq!(nodes[0].params["field"], nodes[2].params["field"]);
    }

    /// A wrong default can be planted, and every draw is above it.
    #[test]
    fn the_base_lies_under_every_trial_and_the_scatter() {
        let table = json!({"trials": 2, "field": {"learning_rate": 0.2, "average": 0.9}});
        let nodes = random(table.clone());
        for (node, rate) in [(0, true), (1, false), (2, true)] {
            let field = &nodes[node].params["field"];
            assert_eq!(field["average"], 0.9, "{field}");
            assert_eq!(field["learning_rate"] == 0.2, rate, "{field}");
        }
        let halving = asked(table);
        assert_eq!(halving[1].params["train"]["field"], nodes[1].params["field"]);
    }

    /// The keys of trials follow from these. Other parameters would retrain the trials of every store.
    #[test]
    fn a_trial_of_a_random_search_has_the_parameters_it_always_had() {
        let device = json!("gpu:a100");
        for (table, given) in [
            (
                json!({"trials": 2, "scale": 3}),
                json!({"scale": 3, "steps": 100}),
            ),
            (
                json!({"trials": 2, "seed": 7, "steps": 40, "quality": "best", "device": device}),
                json!({"seed": 7, "steps": 40, "quality": "best", "scale": 3, "device": device}),
            ),
        ] {
            let mut written = json!({"holdout": "validation"});
            let keys = given.as_object().unwrap().clone();
            written.as_object_mut().unwrap().extend(keys);
            let written: TrainParams = serde_json::from_value(written).unwrap();
            let node = random(table).swap_remove(0);
            let bound: TrainParams = serde_json::from_value(node.params).unwrap();
            assert_eq!(bound, written);
        }
    }
}

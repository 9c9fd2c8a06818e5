use marf_cache::{ContentHash, Digest};
use marf_field::{Config, Device, Facts, Trainer, View};
use marf_scene::Scene;
use marf_stage::{
    Ctx, Define, Expand, Inputs, NodeSpec, Outputs, ParamError, Port, Set, Stage, StageError, Threads, Work,
};
use serde::{Deserialize, Serialize};

use crate::{
    Fit, Holdout, Metrics, PaceParams, TrainError, TrainParams,
    fit::{Fitted, fit, probes},
    judge::{judge, outputs, put_json},
    memory::plan,
    params,
    split::{Split, draws, points, split, views},
    trials::{self, Asked},
};

/// Trains a field on a scene and measures it on the photos held out.
///
/// With `budget` it asks for one node `pace`, which finds the steps; the training then belongs to the
/// reduction. The key of `train` holds the budget; the steps come in by the content of `pace`'s output, which
/// differs between machines. `steps`, as the metrics print them, gives the same field anywhere.
#[derive(Debug)]
pub struct Train {
    params: TrainParams,
}

/// Output `metrics` of `train`. Nothing in it comes from a clock.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// On the photos held out.
    #[serde(flatten)]
    pub metrics: Metrics,
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

impl Define for Train {
    type Params = TrainParams;
    const NAME: &'static str = "train";
    const ABOUT: &'static str = "Trains a radiance field and measures it on held-out photos";
    const VERSION: u32 = 3;
    const PORTS: &'static [Port] = &[
        Port::required("input", "scene"),
        Port::optional("params", "params"),
    ];
    const OUTPUTS: &'static [&'static str] = &["weights", "metrics", "curve", "scene", "heldout/", "photo/"];

    fn new(params: TrainParams) -> Result<Self, ParamError> {
        params.check()?;
        Ok(Self { params })
    }
}

impl Stage for Train {
    fn params(&self) -> &dyn ContentHash {
        &self.params
    }

    fn work(&self) -> Work<'_> {
        match self.params.budget {
            Some(_) => Work::Expand(self),
            None => Work::Set(self),
        }
    }

    fn threads(&self) -> Threads {
        Threads::All
    }

    fn backend_id(&self) -> Option<String> {
        self.params.device.class()
    }
}

impl Set for Train {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let steps = self.params.steps.unwrap_or(self.params.quality.steps());
        train(ctx, inputs, &self.params, steps)
    }
}

impl Expand for Train {
    fn expand(&self, _ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
        let Some(pace) = PaceParams::of(&self.params) else {
            return Ok(Vec::new());
        };
        let params = serde_json::to_value(pace).map_err(|error| StageError::new(error.to_string()))?;
        Ok(vec![NodeSpec {
            name: "pace".to_owned(),
            stage: "pace".to_owned(),
            params,
            inputs: inputs.clone(),
        }])
    }

    fn reduce(&self, ctx: &Ctx<'_>, inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        let found = children.first().and_then(|pace| pace.get("steps"));
        let digest = found.ok_or_else(|| StageError::new("`pace` gave no steps"))?;
        let steps: u64 = crate::judge::get_json(ctx, "steps", digest)?;
        train(
            ctx,
            inputs,
            &self.params,
            trials::less_trials(&self.params, steps),
        )
    }
}

fn train(ctx: &Ctx<'_>, inputs: &Inputs, params: &TrainParams, steps: u64) -> Result<Outputs, StageError> {
    let scene_digest = inputs.required("scene")?;
    let scene = read_scene(ctx, scene_digest)?;
    let keys = params::keys(ctx, inputs, &params.field)?;
    let scale = params::scale(params.scale, params.quality, &scene);
    let split = split(&scene, params.holdout)?;
    let config = params::config(&keys, params.quality, params.fit, steps)?;
    let times = times(&split, params.resample);
    let plan = plan(params.memory, &split, &times, scale, &config)?;
    let tried = Asked {
        scene: &scene,
        split: &split,
        scale,
        keys: &keys,
        params,
        steps,
    };
    let (config, trials) = trials::decide(ctx, &tried, config)?;
    let views = views(ctx, &split, &times, scale, plan, params.seed)?;
    let probes = probes(ctx, &split.held_out, scale)?;
    let trainer = trainer(views, &scene, &config, params.seed, &params.device)?;
    let Fitted { field, log } = fit(ctx, trainer, steps, &probes)?;
    let field = field.with_trials(trials);
    let mut outputs = outputs([("scene", *scene_digest), ("weights", ctx.put(&field.encode())?)]);
    let report = Report {
        metrics: judge(ctx, &field, &split.held_out, scale, &mut outputs)?,
        steps,
        rays: log.rays,
        samples: log.samples,
        loss: log.curve.last().map_or(0.0, |point| point.loss),
        scale,
        thinned: (plan.run > 1).then_some(plan.run),
        seed: params.seed,
        holdout: params.holdout,
        train_photos: times.iter().filter(|times| **times > 0).count() as u64,
        held_out_photos: split.held_out.len() as u64,
        drawn: params.resample.map(|_| drawn(&split, &times)),
        fit: params.fit,
        gpu: params.device.class(),
        config,
        field: field.facts().clone(),
    };
    outputs.insert("metrics".to_owned(), put_json(ctx, &report)?);
    outputs.insert("curve".to_owned(), put_json(ctx, &log.curve)?);
    Ok(outputs)
}

pub(crate) fn read_scene(ctx: &Ctx<'_>, digest: &Digest) -> Result<Scene, StageError> {
    Ok(Scene::decode(&ctx.get(digest)?).map_err(TrainError::from)?)
}

/// Makes a trainer at step 0.
pub(crate) fn trainer(
    views: Vec<View>,
    scene: &Scene,
    config: &Config,
    seed: u64,
    device: &Device,
) -> Result<Trainer, StageError> {
    let trainer = Trainer::new(views, &points(scene), config, seed);
    Ok(trainer
        .and_then(|trainer| trainer.on(device))
        .map_err(TrainError::from)?)
}

/// How often each training photo is used.
fn times(split: &Split<'_>, resample: Option<u64>) -> Vec<usize> {
    let count = split.training.len();
    resample.map_or_else(|| vec![1; count], |seed| draws(count, seed))
}

fn drawn(split: &Split<'_>, times: &[usize]) -> Vec<String> {
    let repeated = split.training.iter().zip(times);
    repeated
        .flat_map(|(named, times)| std::iter::repeat_n(named.frame.id.clone(), *times))
        .collect()
}

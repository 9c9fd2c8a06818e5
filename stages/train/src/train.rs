use marf_cache::{ContentHash, Digest};
use marf_field::{Config, Device, Trainer, View};
use marf_scene::Scene;
use marf_schema::{
    output::{HELDOUT, PHOTO, SCENE, WEIGHTS},
    pace::{PaceParams, Steps},
    train::{Curve, Metrics, TrainParams},
    tune::BestParams,
};
use marf_stage::{
    Ctx, Define, Document, Expand, Inputs, NodeSpec, Outputs, ParamError, Params, Port, Set, Stage,
    StageError, Threads, TypedOutputs, Work,
};

use crate::{
    TrainError,
    fit::{Fitted, fit, probes},
    judge::judge,
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

impl Define for Train {
    type Params = TrainParams;
    const NAME: &'static str = TrainParams::STAGE;
    const ABOUT: &'static str = "Trains a radiance field and measures it on held-out photos";
    const VERSION: u32 = 3;
    const PORTS: &'static [Port] = &[
        Port::required("input", SCENE),
        Port::optional("params", BestParams::OUTPUT),
    ];
    const OUTPUTS: &'static [&'static str] =
        &[WEIGHTS, Metrics::OUTPUT, Curve::OUTPUT, SCENE, HELDOUT, PHOTO];

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
        Ok(vec![NodeSpec::of(PaceParams::STAGE, &pace, inputs)?])
    }

    fn reduce(&self, ctx: &Ctx<'_>, inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        let pace = children
            .first()
            .ok_or_else(|| StageError::new("`pace` gave no steps"))?;
        let Steps(steps) = pace.read(ctx)?;
        train(
            ctx,
            inputs,
            &self.params,
            trials::less_trials(&self.params, steps),
        )
    }
}

fn train(ctx: &Ctx<'_>, inputs: &Inputs, params: &TrainParams, steps: u64) -> Result<Outputs, StageError> {
    let scene_digest = inputs.required(SCENE)?;
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
    let mut outputs = Outputs::from([(SCENE.to_owned(), *scene_digest)]);
    outputs.put_bytes(ctx, WEIGHTS, &field.encode())?;
    let metrics = Metrics {
        scores: judge(ctx, &field, &split.held_out, scale, &mut outputs)?,
        steps,
        rays: log.rays,
        samples: log.samples,
        loss: log.curve.0.last().map_or(0.0, |point| point.loss),
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
    outputs.put(ctx, &metrics)?;
    outputs.put(ctx, &log.curve)?;
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

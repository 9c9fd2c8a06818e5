mod training_loop;
mod trials;

use marf_cache::ContentHash;
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
    child::Child,
    io::read_scene,
    memory::plan_memory,
    photos::PhotoReader,
    scoring::score_views,
    settings::{field_config, field_keys, scale_to},
    split::{Split, draws, split},
    views::{new_trainer, training_views},
};
use training_loop::{TrainedField, curve_photos, train_to};
use trials::TrialRequest;

/// Trains a field on a scene and measures it on the photos held out.
///
/// With `budget` it asks for one node `pace`, which finds the steps, and trains when that has run. The key of `train`
/// then holds the budget, and `pace` finds other steps on another machine; `steps`, as the metrics print them, gives
/// the same field anywhere.
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
    fn params(&self) -> serde_json::Value {
        marf_stage::key_params(&self.params, &["device"])
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
        self.params.device.backend_id()
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
        let outputs = children
            .first()
            .ok_or_else(|| StageError::new("`pace` did not run"))?;
        let name = PaceParams::STAGE.to_owned();
        let Steps(steps) = Child { name, outputs }.read(ctx)?;
        let steps = trials::steps_after_trials(&self.params, steps);
        train(ctx, inputs, &self.params, steps)
    }
}

/// Trains for `steps`, measures the field on the photos held out and stores everything.
fn train(ctx: &Ctx<'_>, inputs: &Inputs, params: &TrainParams, steps: u64) -> Result<Outputs, StageError> {
    let scene = read_scene(ctx, inputs)?;
    let keys = field_keys(ctx, inputs, &params.field)?;
    let side_px = params.quality.longest_side_px();
    let scale = params.scale.unwrap_or_else(|| scale_to(side_px, &scene));
    let split = split(&scene, params.holdout)?;
    let config = field_config(&keys, params.quality, params.fit, steps)?;
    let times = times(&split, params.resample);
    let plan = plan_memory(params.memory, &split, &times, scale, &config)?;
    let request = TrialRequest {
        scene: &scene,
        split: &split,
        scale,
        keys: &keys,
        params,
        steps,
    };
    let (config, trials) = trials::decide(ctx, &request, config)?;
    let photos = PhotoReader::new(ctx, &scene, scale);
    let curve_photos = curve_photos(&photos, &split.held_out, plan.at_once)?;
    let views = training_views(&photos, &split.training, &times, plan, params.seed)?;
    let trainer = new_trainer(views, &scene, &config, params.seed, &params.device)?;
    let TrainedField { field, log } = train_to(ctx, trainer, steps, &curve_photos)?;
    let field = field.with_trials(trials);
    let mut outputs = Outputs::from([(SCENE.to_owned(), *inputs.required(SCENE)?)]);
    outputs.put_bytes(ctx, WEIGHTS, &field.encode())?;
    let metrics = Metrics {
        scores: score_views(ctx, &field, &photos, &split.held_out, &mut outputs)?,
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
        gpu: params.device.backend_id(),
        config,
        field: field.facts().clone(),
    };
    outputs.put(ctx, &metrics)?;
    outputs.put(ctx, &log.curve)?;
    Ok(outputs)
}

/// Returns how often each training photo is used.
fn times(split: &Split<'_>, resample: Option<u64>) -> Vec<usize> {
    let count = split.training.len();
    resample.map_or_else(|| vec![1; count], |seed| draws(count, seed))
}

/// Returns the ids of the training photos, each as often as it is used.
fn drawn(split: &Split<'_>, times: &[usize]) -> Vec<String> {
    let repeated = split.training.iter().zip(times);
    repeated
        .flat_map(|(named, times)| std::iter::repeat_n(named.frame.id.clone(), *times))
        .collect()
}

mod partial;
mod setup;
mod training_loop;
mod trials;

use std::sync::Arc;

use marf_cache::Digest;
use marf_field::{Config, Device, Field, Trainer, Trial};
use marf_scene::{PosedPhoto, Scene, TrainedPhotos};
use marf_schema::{
    output::{HELDOUT, PHOTO, SCENE, STATE, WEIGHTS},
    pace::{PaceParams, Steps},
    train::{Curve, Holdout, Metrics, Setup, TrainParams},
    tune::BestParams,
};
use marf_stage::{
    ChildStage, Ctx, Define, Document, Expand, Inputs, NodeSpec, Outputs, ParamError, Params, Port, Set,
    Stage, StageError, Threads, TypedOutputs, Work,
};

use crate::{
    TrainError,
    checkpoint::{self, identity},
    child::{Child, child_stage},
    io::read_scene,
    memory::MemoryPlan,
    photos::{PhotoReader, ScaledPhoto},
    scoring::Judge,
    split::{NamedFrame, Split, draws, split},
    views::{new_trainer, training_views},
};
pub use partial::Partial;
use setup::Settings;
use training_loop::{Run, TrainingLog, curve_photos, pack, train_to, unpack};

/// Trains a field on a scene and measures it on the photos held out.
///
/// With `budget` it asks for one node `pace`, which finds the steps, and trains when that has run. The key of `train`
/// then holds the budget, and `pace` finds other steps on another machine; `steps`, as the metrics print them, gives
/// the same field anywhere.
///
/// With `from`, the state that `partial` gave of this very training, it goes on from there, to the same field as without.
///
/// With `of`, the setup of another training of the scene, it is that training again: only seed and draw of photos are its
/// own, nothing is derived from the photos drawn and nothing is tried.
#[derive(Debug)]
pub struct Train {
    params: TrainParams,
}

impl Define for Train {
    type Params = TrainParams;
    const NAME: &'static str = TrainParams::STAGE;
    const ABOUT: &'static str = "Trains a radiance field and measures it on held-out photos";
    const VERSION: u32 = 7;
    const PORTS: &'static [Port] = &[
        Port::required("input", SCENE),
        Port::optional("params", BestParams::OUTPUT),
        Port::optional("of", Setup::OUTPUT).deciding(&[
            "params", "quality", "steps", "budget", "scale", "memory", "holdout", "fit", "trials", "field",
        ]),
        Port::optional("from", STATE),
    ];
    const OUTPUTS: &'static [&'static str] = &[
        WEIGHTS,
        Metrics::OUTPUT,
        Setup::OUTPUT,
        Curve::OUTPUT,
        SCENE,
        HELDOUT,
        PHOTO,
    ];

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
        train(ctx, self, inputs, self.params.planned_steps())
    }
}

impl Expand for Train {
    fn children(&self) -> Vec<ChildStage> {
        let pace = PaceParams::of(&self.params);
        pace.iter().map(child_stage).collect()
    }

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
        train(ctx, self, inputs, steps)
    }
}

/// What is known of a training before its first step.
struct Plan<'a> {
    scene: &'a Scene,
    split: &'a Split<'a>,
    /// How often each training photo is used.
    times: &'a [usize],
    memory: MemoryPlan,
    settings: &'a Settings,
    /// What its checkpoints are of.
    of: Digest,
    /// The state that it goes on from; none for step 0.
    from: Option<Arc<[u8]>>,
}

/// Reads all that a training depends on and decides it, and does `work` with that.
fn planned<S: Define, T>(
    ctx: &Ctx<'_>,
    (stage, params): (&S, &TrainParams),
    inputs: &Inputs,
    steps: u64,
    work: impl FnOnce(&Plan<'_>, &PhotoReader<'_>) -> Result<T, StageError>,
) -> Result<T, StageError> {
    let scene = read_scene(ctx, inputs)?;
    let settings = Settings::resolve(ctx, params, inputs, &scene, steps)?;
    let split = split(&scene, settings.holdout, settings.fold)?;
    let times = times(&split, params.resample);
    let from = inputs.optional(STATE).map(|digest| ctx.get(digest));
    let plan = Plan {
        memory: settings.plan_memory(&split, &times)?,
        scene: &scene,
        split: &split,
        times: &times,
        of: identity(stage, inputs, &settings.steps.to_string()),
        from: from.transpose()?,
        settings: &settings,
    };
    work(&plan, &PhotoReader::new(ctx, &scene, settings.scale))
}

/// A field that is trained, with what the metrics tell of its training.
struct Trained {
    field: Field,
    config: Config,
    log: TrainingLog,
}

/// Trains for `steps`, measures the field on the photos held out and stores everything.
fn train(ctx: &Ctx<'_>, stage: &Train, inputs: &Inputs, steps: u64) -> Result<Outputs, StageError> {
    planned(ctx, (stage, &stage.params), inputs, steps, |plan, photos| {
        train_as_planned(ctx, &stage.params, inputs, plan, photos)
    })
}

fn train_as_planned(
    ctx: &Ctx<'_>,
    params: &TrainParams,
    inputs: &Inputs,
    plan: &Plan<'_>,
    photos: &PhotoReader<'_>,
) -> Result<Outputs, StageError> {
    let Trained { field, config, log } = match Trained::load(ctx, &plan.of, &params.device) {
        Some(trained) => trained,
        None => Trained::new(ctx, params, plan, photos)?,
    };
    let (settings, split, times) = (plan.settings, plan.split, plan.times);
    let mut outputs = Outputs::from([(SCENE.to_owned(), *inputs.required(SCENE)?)]);
    outputs.put_bytes(ctx, WEIGHTS, &field.encode())?;
    let setup = settings.setup(plan.memory.run, &config, field.derived());
    outputs.put(ctx, &setup)?;
    let trained = TrainedPhotos::new(plan.scene, trained_on(split, times));
    let mut judge = Judge::new(ctx, plan.of, &field, photos);
    let metrics = Metrics {
        scores: judge.held_out(&split.held_out, &trained, &mut outputs)?,
        on_training: match plan.seen() {
            Some(seen) => Some(judge.on_training(&seen)?),
            None => None,
        },
        steps: settings.steps,
        rays: log.rays,
        samples: log.samples,
        loss: log.curve.0.last().map_or(0.0, |point| point.loss),
        scale: settings.scale,
        thinned: (plan.memory.run > 1).then_some(plan.memory.run),
        seed: params.seed,
        holdout: settings.holdout,
        fold: settings.fold,
        train_photos: times.iter().filter(|times| **times > 0).count() as u64,
        held_out_photos: split.held_out.len() as u64,
        drawn: params.resample.map(|_| drawn(split, times)),
        fit: settings.fit,
        gpu: params.device.backend_id(),
        config,
        field: field.facts().clone(),
    };
    outputs.put(ctx, &metrics)?;
    outputs.put(ctx, &log.curve)?;
    Ok(outputs)
}

/// A training whose parts are decided, before its first step.
struct Begun<'a> {
    trainer: Trainer,
    config: Config,
    trials: Vec<Trial>,
    curve_photos: Vec<(NamedFrame<'a>, ScaledPhoto)>,
}

impl<'a> Begun<'a> {
    /// Decides the parts of the field by trials, and reads the photos.
    fn new(
        ctx: &Ctx<'_>,
        params: &TrainParams,
        plan: &Plan<'a>,
        photos: &PhotoReader<'_>,
    ) -> Result<Self, StageError> {
        let (config, trials) = trials::decide(ctx, params, plan)?;
        let curve_photos = curve_photos(photos, &plan.split.held_out, plan.memory.at_once)?;
        let training = &plan.split.training;
        let views = training_views(photos, training, plan.times, plan.memory, params.seed)?;
        let derived = plan.settings.given.as_ref().map(|given| &given.derived);
        Ok(Self {
            trainer: new_trainer(views, plan.scene, &config, params.seed, derived, &params.device)?,
            config,
            trials,
            curve_photos,
        })
    }
}

impl<'a> Plan<'a> {
    /// Returns some of the photos that are trained on, where the photos of the final metric are held out.
    fn seen(&self) -> Option<Vec<NamedFrame<'a>>> {
        if self.settings.holdout != Holdout::Test || self.settings.fold.is_some() {
            return None;
        }
        let used: Vec<&NamedFrame<'a>> = used(self.split, self.times).collect();
        let seen = spread(used.len(), self.split.held_out.len());
        Some(seen.map(|index| used[index].clone()).collect())
    }

    /// Returns the run of this training until a step.
    fn run<'r>(&'r self, until: u64, curve_photos: &'r [(NamedFrame<'r>, ScaledPhoto)]) -> Run<'r> {
        Run {
            steps: self.settings.steps,
            until,
            from: self.from.as_deref(),
            part: "training",
            of: self.of,
            note: "",
            curve_photos,
        }
    }
}

impl Trained {
    /// Part of the checkpoint that holds the field between its training and the last photo judged.
    const PART: &'static str = "trained";

    /// Trains the field.
    fn new(
        ctx: &Ctx<'_>,
        params: &TrainParams,
        plan: &Plan<'_>,
        photos: &PhotoReader<'_>,
    ) -> Result<Self, StageError> {
        let steps = plan.settings.steps;
        let Begun {
            mut trainer,
            config,
            trials,
            curve_photos,
        } = Begun::new(ctx, params, plan, photos)?;
        let log = train_to(ctx, &plan.run(steps, &curve_photos), &mut trainer)?;
        let field = trainer.field().map_err(TrainError::from)?;
        let trained = Self {
            field: field.with_trials(trials),
            config,
            log,
        };
        let facts = (&trained.config, &trained.log);
        checkpoint::save(ctx, Self::PART, &plan.of, &pack(&facts, &trained.field.encode()));
        Ok(trained)
    }

    /// Returns the field that an unfinished run has trained.
    fn load(ctx: &Ctx<'_>, of: &Digest, device: &Device) -> Option<Self> {
        let state = checkpoint::load(ctx, Self::PART, of)?;
        let ((config, log), field) = unpack(&state)?;
        let field = Field::decode(field).and_then(|field| field.on(device));
        Some(Self {
            field: field.ok()?,
            config,
            log,
        })
    }
}

/// Returns `wanted` indices below `count`, or all, evenly spaced.
fn spread(count: usize, wanted: usize) -> impl Iterator<Item = usize> {
    let wanted = wanted.min(count);
    (0..wanted).map(move |index| (2 * index + 1) * count / (2 * wanted))
}

/// Returns how often each training photo is used.
fn times(split: &Split<'_>, resample: Option<u64>) -> Vec<usize> {
    let count = split.training.len();
    resample.map_or_else(|| vec![1; count], |seed| draws(count, seed))
}

/// Returns the training photos that are used.
fn used<'s, 'a>(split: &'s Split<'a>, times: &'s [usize]) -> impl Iterator<Item = &'s NamedFrame<'a>> {
    let used = split.training.iter().zip(times).filter(|(_, times)| **times > 0);
    used.map(|(named, _)| named)
}

/// Returns where the training photos that are used were taken.
fn trained_on<'a>(split: &Split<'a>, times: &[usize]) -> Vec<PosedPhoto<'a>> {
    used(split, times).map(|named| named.frame.into()).collect()
}

/// Returns the ids of the training photos, each as often as it is used.
fn drawn(split: &Split<'_>, times: &[usize]) -> Vec<String> {
    let repeated = split.training.iter().zip(times);
    repeated
        .flat_map(|(named, times)| std::iter::repeat_n(named.frame.id.clone(), *times))
        .collect()
}

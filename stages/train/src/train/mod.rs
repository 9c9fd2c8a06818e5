mod clock;
mod foreseen;
mod goal;
mod partial;
mod setup;
mod training_loop;
mod trials;
mod warm;

use std::sync::Arc;
use std::time::Instant;

use marf_cache::Digest;
use marf_field::{Config, Device, Field, Trainer, Trial};
use marf_scene::{PosedPhoto, Scene, TrainedPhotos};
use marf_schema::{
    output::{HELDOUT, PHOTO, SCENE, STATE, WEIGHTS},
    train::{BEFORE_STOP, Curve, Holdout, Metrics, Setup, Target, TrainParams},
    tune::BestParams,
};
use marf_stage::{
    Ctx, Define, Document, Inputs, Outputs, ParamError, Params, Port, Set, Stage, StageError, Threads,
    TypedOutputs, Work,
};
use serde::{Deserialize, Serialize};

use crate::{
    TrainError,
    checkpoint::{self, identity},
    io::read_scene,
    memory::MemoryPlan,
    photos::{PhotoReader, ScaledPhoto},
    scoring::{Chosen, Judge},
    split::{NamedFrame, Split, draws, hold_out_by_place, some_of, split, spread},
    views::{Begin, new_trainer, training_views},
};
use clock::Clock;
use goal::Goal;
pub use partial::Partial;
use setup::Settings;
use training_loop::{Run, TrainingLog, curve_photos, pack, train_to, unpack};
use warm::Start;

/// Trains a field on a scene and measures it on the photos held out.
///
/// With `budget` or `within` it trains by the clock and is no pure function: its first result stands. The key holds the time; the
/// schedule that was run, as setup and metrics print it, repeats the bytes anywhere (`schedule`).
///
/// With `from`, the state that `partial` gave of this very training, it goes on from there, to the same field as without.
///
/// With `warm_start` it starts from the field of its own last run, where that fits the scene, and says where it does not.
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
    const ABOUT: &'static str = "trains a radiance field and measures it on held-out photos";
    const VERSION: u32 = 19;
    const PORTS: &'static [Port] = &[
        Port::required("input", SCENE),
        Port::optional("params", BestParams::OUTPUT),
        Port::optional("of", Setup::OUTPUT).deciding(&[
            "params",
            "quality",
            "steps",
            "budget",
            "within",
            "schedule",
            "target_psnr",
            "scale",
            "photos",
            "memory",
            "holdout",
            "fit",
            "trials",
            "field",
            "warm_start",
        ]),
        Port::optional("from", STATE).deciding(&["warm_start"]),
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
        Work::Set(self)
    }

    fn threads(&self) -> Threads {
        Threads::All
    }

    fn backend_id(&self) -> Option<String> {
        self.params.device.backend_id()
    }

    fn backend_id_on(&self, gpu: Option<&str>) -> Result<Option<String>, StageError> {
        self.params.device.backend_id_on(gpu).map_err(StageError::new)
    }

    fn varies(&self) -> Option<&'static str> {
        self.params.limit().map(|_| "it trains by the clock")
    }

    fn earlier(&self) -> Option<&'static str> {
        self.params.warm_start.then_some(WEIGHTS)
    }
}

impl Set for Train {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        planned(ctx, (self, &self.params), inputs, |plan, photos| {
            train(ctx, &self.params, inputs, &plan, photos)
        })
    }
}

/// What is known of a training before its first step.
struct Plan<'a> {
    scene: &'a Scene,
    split: &'a Split<'a>,
    /// Training photos held back to watch a target by.
    validation: &'a [NamedFrame<'a>],
    /// How often each training photo is used.
    times: &'a [usize],
    memory: MemoryPlan,
    settings: Settings,
    /// What it starts from.
    start: Start,
    /// What its checkpoints are of.
    of: Digest,
    /// The state that it goes on from; none for step 0.
    from: Option<Arc<[u8]>>,
    /// The time that it may take.
    clock: Option<Clock>,
    judging: Judging,
}

/// By which photos a field is judged.
#[derive(Debug, Clone, Copy)]
struct Judging {
    /// Whole factor by which they are shrunk: as those trained on, unless a time chooses these.
    scale: u32,
    /// Which of those held out.
    chosen: Chosen,
}

/// Reads all that a training depends on and decides it, and does `work` with that.
fn planned<S: Define, T>(
    ctx: &Ctx<'_>,
    (stage, params): (&S, &TrainParams),
    inputs: &Inputs,
    work: impl FnOnce(Plan<'_>, &PhotoReader<'_>) -> Result<T, StageError>,
) -> Result<T, StageError> {
    let scene = read_scene(ctx, inputs)?;
    let mut settings = Settings::resolve(ctx, params, inputs, &scene)?;
    let (split, validation) = parted(&scene, &settings)?;
    let start = Start::decide(ctx, params, inputs, &scene, (&split, &validation), &mut settings)?;
    let times = times(&split, params.resample);
    let from = inputs.optional(STATE).map(|digest| ctx.get(digest));
    let photos = PhotoReader::new(ctx, &scene, settings.scale);
    let judging = Judging {
        scale: params.judged_scale.unwrap_or(settings.scale),
        chosen: Chosen {
            most: params.judged_photos.map(|photos| photos as usize),
            until: params.within.map(|wait| ctx.began + wait.duration()),
        },
    };
    let mut plan = Plan {
        judging,
        memory: settings.plan_memory(&split, &times, judging.scale)?,
        scene: &scene,
        split: &split,
        validation: &validation,
        times: &times,
        of: identity(stage, inputs, &settings.length()),
        from: from.transpose()?,
        settings,
        start,
        clock: None,
    };
    if let Some(limit) = params.limit() {
        plan.clock = Some(Clock::paced(ctx, (params, limit), &mut plan, &photos)?);
    }
    let photos = photos.at(&scene, plan.settings.scale);
    work(plan, &photos)
}

/// Splits a scene into photos to train on and to judge by, and those held back to watch a target by.
fn parted<'a>(scene: &'a Scene, settings: &Settings) -> Result<(Split<'a>, Vec<NamedFrame<'a>>), TrainError> {
    let mut whole = split(scene, settings.holdout, settings.fold)?;
    if let Some(most) = settings.photos {
        whole.training = some_of(whole.training, most as usize);
    }
    if !settings.watched {
        return Ok((whole, Vec::new()));
    }
    let photos = whole.training.len();
    let inner = hold_out_by_place(whole.training, &scene.points);
    if inner.training.is_empty() || inner.held_out.is_empty() {
        return Err(TrainError::NoValidation { photos });
    }
    let split = Split {
        training: inner.training,
        held_out: whole.held_out,
    };
    Ok((split, inner.held_out))
}

/// A field that is trained, with what the metrics tell of its training.
struct Trained {
    field: Field,
    told: Told,
}

/// What is told of a training beside its field.
#[derive(Serialize, Deserialize)]
struct Told {
    config: Config,
    log: TrainingLog,
    target: Option<Target>,
    /// Seconds of trials and steps.
    seconds: f64,
}

/// Trains, measures the field on the photos held out and stores everything.
fn train(
    ctx: &Ctx<'_>,
    params: &TrainParams,
    inputs: &Inputs,
    plan: &Plan<'_>,
    photos: &PhotoReader<'_>,
) -> Result<Outputs, StageError> {
    let Trained { field, told } = match Trained::load(ctx, &plan.of, &params.device) {
        Some(trained) => {
            ctx.progress.took(BEFORE_STOP, trained.told.seconds);
            trained
        }
        None => Trained::new(ctx, params, plan, photos)?,
    };
    ctx.progress.took("training", told.seconds);
    ctx.timed("judging", || {
        judged(ctx, params, inputs, plan, photos, (&field, told))
    })
}

/// Judges a trained field and stores everything.
fn judged(
    ctx: &Ctx<'_>,
    params: &TrainParams,
    inputs: &Inputs,
    plan: &Plan<'_>,
    photos: &PhotoReader<'_>,
    (field, told): (&Field, Told),
) -> Result<Outputs, StageError> {
    let (log, config) = (told.log, told.config);
    let (settings, split, times) = (&plan.settings, plan.split, plan.times);
    let photos = &photos.at(plan.scene, plan.judging.scale);
    let ended = settings.ended(field.facts(), log.clocked.as_ref());
    let mut outputs = Outputs::from([(SCENE.to_owned(), *inputs.required(SCENE)?)]);
    outputs.put_bytes(ctx, WEIGHTS, &field.encode())?;
    let setup = settings.setup(plan.memory.run, &ended, (&config, field.derived()), &plan.start);
    outputs.put(ctx, &setup)?;
    let trained = TrainedPhotos::new(plan.scene, trained_on(split, times));
    let mut judge = Judge::new(ctx, plan.of, field, photos);
    let metrics = Metrics {
        scores: judge.held_out(&split.held_out, plan.judging.chosen, &trained, &mut outputs)?,
        on_training: match plan.seen() {
            Some(seen) => Some(judge.on_training(&seen)?),
            None => None,
        },
        warm_start: plan.start.told.clone(),
        target: told.target,
        steps: ended.steps,
        schedule: ended.schedule,
        rays: log.rays,
        samples: log.samples,
        loss: log.curve.0.last().map_or(0.0, |point| point.loss),
        scale: settings.scale,
        judged_scale: Some(plan.judging.scale).filter(|scale| *scale != settings.scale),
        thinned: (plan.memory.run > 1).then_some(plan.memory.run),
        seed: params.seed,
        holdout: settings.holdout,
        fold: settings.fold,
        train_photos: times.iter().filter(|times| **times > 0).count() as u64,
        held_out_photos: split.held_out.len() as u64,
        drawn: (params.resample.is_some() || settings.photos.is_some()).then(|| drawn(split, times)),
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
    config: Config,
    trials: Vec<Trial>,
    curve_photos: Vec<(NamedFrame<'a>, ScaledPhoto)>,
    /// Seconds that the trials took.
    trials_s: f64,
}

impl<'a> Begun<'a> {
    /// Decides the parts of the field by trials, reads the photos and returns the trainer at step 0.
    fn new(
        ctx: &Ctx<'_>,
        params: &TrainParams,
        plan: &Plan<'a>,
        photos: &PhotoReader<'_>,
    ) -> Result<(Trainer, Self), StageError> {
        let began = Instant::now();
        let (config, trials) = trials::decide(ctx, params, plan)?;
        let trials_s = began.elapsed().as_secs_f64();
        let curve_photos = curve_photos(photos, &plan.split.held_out, plan.memory.at_once)?;
        let training = &plan.split.training;
        let views = training_views(photos, training, plan.times, plan.memory, params.seed)?;
        let trainer = new_trainer(
            views,
            plan.scene,
            &config,
            params.seed,
            plan.begin(),
            &params.device,
        )?;
        let begun = Self {
            config,
            trials,
            curve_photos,
            trials_s,
        };
        Ok((trainer, begun))
    }
}

impl<'a> Plan<'a> {
    /// Returns some of the photos that are trained on, where the photos of the final metric are held out.
    fn seen(&self) -> Option<Vec<NamedFrame<'a>>> {
        let is_quick = self.judging.chosen != Chosen::ALL;
        if is_quick || self.settings.holdout != Holdout::Test || self.settings.fold.is_some() {
            return None;
        }
        let used: Vec<&NamedFrame<'a>> = used(self.split, self.times).collect();
        let seen = spread(used.len(), self.split.held_out.len());
        Some(seen.map(|index| used[index].clone()).collect())
    }

    /// Returns what its trainer begins with.
    fn begin(&self) -> Begin<'_> {
        match (&self.start.field, &self.settings.given) {
            (Some(field), _) => Begin::From(field),
            (None, Some(given)) => Begin::Sized(&given.derived),
            (None, None) => Begin::Anew,
        }
    }

    /// Returns a trained field with what its bytes tell beside its weights: trials, and the photos that a later training must know.
    fn finished(&self, field: Field, trials: Vec<Trial>, trainer: &mut Trainer) -> Result<Field, TrainError> {
        let Some(_) = &self.start.told else {
            return Ok(field.with_trials(trials));
        };
        let learnt = trainer.learnt(self.scene.metres_per_unit)?;
        let Some(earlier) = &self.start.field else {
            return Ok(field.with_trials(trials).with_learnt(learnt));
        };
        let learnt = match earlier.learnt() {
            Some(before) => learnt.and(before),
            None => learnt,
        };
        Ok(field
            .with_trials(earlier.facts().trials.clone())
            .with_learnt(learnt))
    }

    /// Returns the run of this training.
    fn run<'r>(&'r self, begun: &'r Begun<'_>) -> Run<'r> {
        Run {
            schedule: self.settings.schedule.clone(),
            until: self.settings.until,
            from: self.from.as_deref(),
            curve_photos: &begun.curve_photos,
            clock: self.clock.map(|clock| clock.after(begun.trials_s)),
            ..Run::once(1, ("training", self.of))
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
        let (mut trainer, begun) = Begun::new(ctx, params, plan, photos)?;
        let began = Instant::now();
        let goal = params
            .target_psnr
            .map(|psnr| Goal::new(psnr, photos, plan.memory.at_once, plan.validation));
        let goal = goal.transpose()?;
        let run = Run {
            goal: goal.as_ref(),
            photo_s: Some(&|trainer: &mut Trainer| plan.photo_s(ctx, photos, trainer)),
            ..plan.run(&begun)
        };
        let log = train_to(ctx, &run, &mut trainer)?;
        let own_s = began.elapsed().as_secs_f64();
        let before_s = log.before_stop_s(trainer.steps(), own_s);
        if before_s > 0.0 {
            ctx.progress.took(BEFORE_STOP, before_s);
        }
        let field = trainer.field().map_err(TrainError::from)?;
        let unclocked_s = begun.trials_s + before_s + own_s;
        let watched = log.watched.clone().unwrap_or_default();
        let trained = Self {
            told: Told {
                target: goal
                    .map(|goal| goal.told(ctx, &watched, &field, trainer.steps()))
                    .transpose()?,
                seconds: log.clocked.as_ref().map_or(unclocked_s, |clocked| clocked.used_s),
                config: begun.config,
                log,
            },
            field: plan.finished(field, begun.trials, &mut trainer)?,
        };
        checkpoint::save(
            ctx,
            Self::PART,
            &plan.of,
            &pack(&trained.told, &trained.field.encode()),
        );
        Ok(trained)
    }

    /// Returns the field that an unfinished run has trained.
    fn load(ctx: &Ctx<'_>, of: &Digest, device: &Device) -> Option<Self> {
        let state = checkpoint::load(ctx, Self::PART, of)?;
        let (told, field) = unpack(&state)?;
        let field = Field::decode(field).and_then(|field| field.on(device));
        Some(Self {
            field: field.ok()?,
            told,
        })
    }
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

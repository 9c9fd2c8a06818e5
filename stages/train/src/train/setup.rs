//! What decides a training before it begins: its own parameters, or the setup of another training.

use marf_depth::TargetDetail;
use marf_field::{
    Config, DepthSource, Derived, EXPECTED_STEPS_PER_S, FEW_PHOTOS, Facts, Field, Gain, OpenSizes, Overrides,
    Quality, Schedule,
};
use marf_scene::{Falloff, Scene, Tones};
use marf_schema::train::{Budget, Fit, Fold, Holdout, Memory, Setup, TrainParams, WarmStart};
use marf_stage::{Ctx, Inputs, StageError};

use crate::{
    TrainError,
    io::read_setup,
    memory::{MemoryPlan, plan_memory},
    settings::{field_config, field_keys, scale_to},
    split::Split,
};

/// Matching pairs of photos pays from so many steps a photo on: it takes as long as one to five steps a photo.
const LEAST_STEPS_A_PHOTO: u64 = 16;

/// Settings of a training, all resolved but the box and the sizes where no other training has derived them.
pub(super) struct Settings {
    /// After how many steps the training ends.
    pub schedule: Schedule,
    /// Whether training photos are held back to watch a target by.
    pub watched: bool,
    /// Steps after which it stops before its end, as the training did whose setup this is.
    pub until: Option<u64>,
    pub scale: u32,
    pub memory: Memory,
    /// Most training photos that are used. `None` means all.
    pub photos: Option<u64>,
    pub holdout: Holdout,
    pub fold: Option<Fold>,
    pub fit: Fit,
    /// Keys of the field that are set.
    pub keys: Overrides,
    /// The field.
    pub config: Config,
    /// What another training decided.
    pub given: Option<GivenSizes>,
    /// Whether the field is that of an earlier run.
    follows: bool,
}

/// What a training takes over that it would otherwise derive.
pub(super) struct GivenSizes {
    kept_every: u32,
    pub derived: Derived,
}

impl Settings {
    /// Returns the setup of the input `training`, or one from the parameters. Until it is measured, a budget is planned as for a machine of
    /// two cores.
    pub fn resolve(
        ctx: &Ctx<'_>,
        params: &TrainParams,
        inputs: &Inputs,
        scene: &Scene,
    ) -> Result<Self, StageError> {
        if let Some(setup) = read_setup(ctx, inputs)? {
            return Ok(Self::from_setup(setup, params.fold));
        }
        let schedule = scheduled(params);
        let keys = field_keys(ctx, inputs, &params.field)?;
        let mut config = field_config(&keys, params.fit, schedule.first())?;
        if let (Some(tones), Fit::Scene) = (&scene.tones, params.fit) {
            choose_terms(tones, &keys, &mut config);
        }
        Ok(Self {
            scale: params
                .scale
                .unwrap_or_else(|| scale_to(Quality::LONGEST_SIDE_PX, scene)),
            memory: params.memory,
            photos: params.photos,
            holdout: params.holdout,
            fold: params.fold,
            fit: params.fit,
            config,
            keys,
            given: None,
            follows: false,
            schedule,
            until: None,
            watched: params.target_psnr.is_some(),
        })
    }

    /// Lets pairs of photos show where surfaces are if the photos are few, or if matching them takes little of the time of the training
    /// (`benches/field.md`).
    pub fn choose_depth_source(&mut self, params: &TrainParams, photos: usize) {
        let is_open =
            self.fit == Fit::Scene && !self.is_decided() && !self.keys.0.contains_key("depth_source");
        let steps = params.within.map_or(self.schedule.steps(), expected_steps);
        if is_open && (photos < FEW_PHOTOS || steps >= LEAST_STEPS_A_PHOTO * photos as u64) {
            self.config.depth_source = DepthSource::Pairs;
        }
    }

    /// Plans for `steps` of `batch_samples` each, before the first step, since sizes follow from them.
    pub fn plan_steps(&mut self, steps: u64, batch_samples: u32) {
        self.schedule = Schedule::once(steps);
        self.config.steps = Some(self.schedule.first());
        self.config.batch_samples = batch_samples;
    }

    /// Returns the sizes that may follow the pace of the device: no other training decides, and no key says the samples of a step.
    pub fn open_sizes(&self) -> OpenSizes {
        if self.is_decided() {
            return OpenSizes::Nothing;
        }
        if self.keys.0.contains_key("batch_samples") {
            return OpenSizes::Table;
        }
        OpenSizes::BatchAndTable
    }

    /// Takes over the hyper-parameters of a field that the training starts from, but not what pulls: the number of photos decides that.
    pub fn follow(&mut self, field: &Field) {
        self.follows = true;
        self.config = Config {
            steps: self.config.steps,
            depth_source: self.config.depth_source,
            ..field.config().clone()
        };
    }

    /// Returns whether the parts of the field are decided.
    pub fn is_decided(&self) -> bool {
        self.follows || self.given.is_some()
    }

    /// Takes over a setup. A fold trains its share of the steps, with step size and length of steps along rays to match.
    fn from_setup(setup: Setup, fold: Option<Fold>) -> Self {
        let schedule = match fold {
            Some(fold) => Schedule::once(fold.steps_of(setup.steps)),
            None => setup.schedule(),
        };
        Self {
            watched: setup.watched && fold.is_none(),
            until: Some(setup.steps).filter(|steps| *steps < schedule.steps()),
            scale: setup.scale,
            memory: setup.memory,
            photos: setup.photos,
            holdout: setup.holdout,
            fold: fold.or(setup.fold),
            fit: setup.fit,
            keys: Overrides::default(),
            config: Config {
                steps: Some(schedule.first()),
                ..setup.config
            },
            schedule,
            given: Some(GivenSizes {
                kept_every: setup.kept_every,
                derived: setup.derived,
            }),
            follows: false,
        }
    }

    /// Returns the text that fixes after how many steps the training ends, for the identity of its checkpoints.
    pub fn length(&self) -> String {
        format!("{:?} {:?}", self.schedule, self.until)
    }

    /// Returns how long the training of a field was, and by which schedule if its time has made one.
    pub fn length_of(&self, facts: &Facts, by_time: Option<&Schedule>) -> TrainingLength {
        let schedule = by_time.unwrap_or(&self.schedule);
        let is_plain = *schedule == Schedule::once(facts.steps);
        TrainingLength {
            steps: facts.steps,
            schedule: (!is_plain).then(|| schedule.clone()),
        }
    }

    /// Returns how photos are kept: as in the training whose setup this is, or so that they fit the memory.
    pub fn plan_memory(
        &self,
        split: &Split<'_>,
        times: &[usize],
        judged_scale: u32,
    ) -> Result<MemoryPlan, TrainError> {
        let scales = [self.scale, judged_scale];
        let plan = plan_memory(self.memory, split, times, scales, &self.config)?;
        Ok(MemoryPlan {
            run: self.given.as_ref().map_or(plan.run, |given| given.kept_every),
            ..plan
        })
    }

    /// Returns the setup of the training that has led to a field with this configuration, where one pixel of `kept_every` was kept.
    pub fn setup(
        &self,
        kept_every: u32,
        length: &TrainingLength,
        config: &Config,
        derived: Derived,
        warm_start: Option<WarmStart>,
    ) -> Setup {
        Setup {
            steps: length.steps,
            schedule: length.schedule.clone(),
            watched: self.watched,
            scale: self.scale,
            kept_every,
            memory: self.memory,
            photos: self.photos,
            holdout: self.holdout,
            fold: self.fold,
            warm_start,
            fit: self.fit,
            config: config.clone(),
            derived,
        }
    }
}

/// How long a training was.
pub(super) struct TrainingLength {
    pub steps: u64,
    /// `None` if the end was planned once and not moved.
    pub schedule: Option<Schedule>,
}

/// Switches on the terms between scene and photos that the tones of matched points call for, where no key decides.
fn choose_terms(tones: &Tones, keys: &Overrides, config: &mut Config) {
    let is_open = |key: &str| !keys.0.contains_key(key);
    if tones.difference.is_real() && is_open("gain") {
        config.gain = Gain::PerPhotoAndOffset;
    }
    if tones.vignetting.iter().any(Falloff::is_real) && is_open("vignetting") {
        config.vignetting = marf_field::Vignetting::PerCamera;
    }
}

/// Returns the steps of a time on a machine of two cores.
fn expected_steps(time: Budget) -> u64 {
    (time.seconds() * EXPECTED_STEPS_PER_S) as u64
}

/// Returns how finely photos are matched for a training on so many.
pub(super) fn target_detail(photos: usize) -> TargetDetail {
    if photos < FEW_PHOTOS {
        TargetDetail::Fine
    } else {
        TargetDetail::Coarse
    }
}

/// Returns the schedule that the parameters say.
fn scheduled(params: &TrainParams) -> Schedule {
    match (&params.schedule, params.budget) {
        (Some(schedule), _) => schedule.clone(),
        (None, Some(budget)) => Schedule::once(expected_steps(budget)),
        (None, None) => {
            let steps = params.planned_steps();
            Schedule::once(params.fold.map_or(steps, |fold| fold.steps_of(steps)))
        }
    }
}

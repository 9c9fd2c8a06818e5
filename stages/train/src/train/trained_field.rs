//! The field of a training: trained, measured on the photos held out and stored.

use std::time::Instant;

use marf_cache::Digest;
use marf_field::{Config, Device, Field, Schedule, Trainer};
use marf_schema::{
    output::{SCENE, WEIGHTS},
    train::{BEFORE_STOP, Metrics, Target, TrainParams},
};
use marf_stage::{Ctx, Inputs, Outputs, StageError, TypedOutputs};
use serde::{Deserialize, Serialize};

use super::{
    log::{TrainingLog, pack, unpack},
    plan::Plan,
    planner::PsnrTarget,
    training::{Training, run_of},
    training_loop::train_to,
};
use crate::{TrainError, checkpoint, depth_views::trained_photos, photos::PhotoReader, scoring::Judge};

/// A field with the facts of its training.
pub(super) struct TrainedField {
    field: Field,
    facts: TrainingFacts,
}

/// What the metrics say of a training.
#[derive(Serialize, Deserialize)]
struct TrainingFacts {
    config: Config,
    log: TrainingLog,
    target: Option<Target>,
    /// Seconds of its steps.
    seconds: f64,
}

impl TrainedField {
    /// Part of the checkpoint that holds the field between its training and the last photo judged.
    const PART: &'static str = "trained";

    /// Trains the field, or takes that of an unfinished run.
    ///
    /// # Errors
    /// Those of a training.
    pub fn new(
        ctx: &Ctx<'_>,
        params: &TrainParams,
        plan: &Plan<'_>,
        photos: &PhotoReader<'_>,
    ) -> Result<Self, StageError> {
        let trained = match Self::load(ctx, &plan.identity, &params.device) {
            Some(trained) => {
                ctx.progress.took(BEFORE_STOP, trained.facts.seconds);
                trained
            }
            None => Self::train(ctx, params, plan, photos)?,
        };
        ctx.progress.took("training", trained.facts.seconds);
        Ok(trained)
    }

    fn train(
        ctx: &Ctx<'_>,
        params: &TrainParams,
        plan: &Plan<'_>,
        photos: &PhotoReader<'_>,
    ) -> Result<Self, StageError> {
        let Training {
            mut trainer,
            curve_photos,
        } = Training::new(params, plan, photos)?;
        let began = Instant::now();
        let target = params
            .target_psnr
            .map(|psnr| PsnrTarget::new(psnr, photos, plan.memory.at_once, &plan.photos.validation));
        let measure_judging = |trainer: &mut Trainer| plan.photo_s(ctx, photos, trainer);
        let mut planner = plan.planner();
        planner.target = target.transpose()?;
        planner.photo_s = Some(&measure_judging);
        let mut run = run_of(plan, &curve_photos, planner);
        let log = train_to(ctx, &mut run, &mut trainer)?;
        let own_s = began.elapsed().as_secs_f64();
        let before_s = log.before_stop_s(trainer.steps(), own_s);
        if before_s > 0.0 {
            ctx.progress.took(BEFORE_STOP, before_s);
        }
        let field = trainer.field().map_err(TrainError::from)?;
        let unclocked_s = before_s + own_s;
        let looks = log.planner.looks();
        let target = run.planner.target.as_ref();
        let facts = TrainingFacts {
            target: target
                .map(|target| target.report(ctx, &looks, &field, trainer.steps()))
                .transpose()?,
            seconds: log.planner.time.map_or(unclocked_s, |time| time.used_s),
            config: plan.settings.config.clone(),
            log,
        };
        let trained = Self {
            facts,
            field: finished(plan, field, &mut trainer)?,
        };
        let bytes = pack(&trained.facts, &trained.field.encode());
        checkpoint::save(ctx, Self::PART, &plan.identity, &bytes);
        Ok(trained)
    }

    /// Returns the field that an unfinished run has trained.
    fn load(ctx: &Ctx<'_>, identity: &Digest, device: &Device) -> Option<Self> {
        let state = checkpoint::load(ctx, Self::PART, identity)?;
        let (facts, field) = unpack(&state)?;
        let field = Field::decode(field).and_then(|field| field.with_backend(marf_field_gpu::open(device)?));
        Some(Self {
            field: field.ok()?,
            facts,
        })
    }

    /// Measures the field on the photos held out and stores everything.
    ///
    /// # Errors
    /// A photo that cannot be read, a field that cannot be rendered, a store that fails.
    pub fn judge(
        self,
        ctx: &Ctx<'_>,
        params: &TrainParams,
        inputs: &Inputs,
        plan: &Plan<'_>,
        photos: &PhotoReader<'_>,
    ) -> Result<Outputs, StageError> {
        let Self { field, facts } = self;
        let TrainingFacts {
            config, log, target, ..
        } = facts;
        let (settings, set) = (&plan.settings, &plan.photos);
        let photos = &photos.at(set.scene, plan.judging.scale);
        let by_time: Option<&Schedule> = log.planner.schedule.as_ref();
        let length = settings.length_of(field.facts(), by_time);
        let mut outputs = Outputs::from([(SCENE.to_owned(), *inputs.required(SCENE)?)]);
        outputs.put_bytes(ctx, WEIGHTS, &field.encode())?;
        let warm_start = plan.start.report.clone();
        let setup = settings.setup(
            plan.memory.run,
            &length,
            &config,
            field.derived(),
            warm_start.clone(),
        );
        outputs.put(ctx, &setup)?;
        let trained = trained_photos(&field, photos, set.scene, &set.trained_on())?;
        let mut judge = Judge::new(ctx, plan.identity, &field, photos);
        let held_out = &set.split.held_out;
        let metrics = Metrics {
            scores: judge.held_out(held_out, plan.judging.photos, &trained, &mut outputs)?,
            on_training: match plan.seen() {
                Some(seen) => Some(judge.on_training(&seen)?),
                None => None,
            },
            tones: set.scene.tones.as_ref().map(|tones| tones.difference),
            vignetting: set
                .scene
                .tones
                .as_ref()
                .map_or_else(Vec::new, |tones| tones.vignetting.clone()),
            warm_start,
            target,
            steps: length.steps,
            schedule: length.schedule,
            rays: log.rays,
            samples: log.samples,
            loss: log.curve.0.last().map_or(0.0, |point| point.loss),
            scale: settings.scale,
            judged_scale: Some(plan.judging.scale).filter(|scale| *scale != settings.scale),
            thinned: (plan.memory.run > 1).then_some(plan.memory.run),
            seed: params.seed,
            holdout: settings.holdout,
            fold: settings.fold,
            train_photos: set.used().count() as u64,
            held_out_photos: held_out.len() as u64,
            drawn: set.drawn(),
            fit: settings.fit,
            gpu: marf_field_gpu::backend_id(&params.device),
            config,
            field: field.facts().clone(),
        };
        outputs.put(ctx, &metrics)?;
        outputs.put(ctx, &log.curve)?;
        Ok(outputs)
    }
}

/// Returns a trained field with the photos that a later training must know.
fn finished(plan: &Plan<'_>, field: Field, trainer: &mut Trainer) -> Result<Field, TrainError> {
    if plan.start.report.is_none() {
        return Ok(field);
    }
    let learnt = trainer.learnt(plan.photos.scene.metres_per_unit)?;
    let before = plan.start.field.as_ref().and_then(Field::learnt);
    Ok(field.with_learnt(match before {
        Some(before) => learnt.and(before),
        None => learnt,
    }))
}

//! Short trainings that decide which parts of the field are used, by PSNR on training photos held back.

use std::time::Instant;

use marf_cache::digest_of;
use marf_field::{Config, Quality, Schedule, Trial, View};
use marf_schema::train::{Fit, TrainParams};
use marf_stage::{Ctx, StageError};

use super::{
    parts::{PARTS, Part},
    plan::Plan,
    planner::Planner,
    training_loop::{Run, train_to},
};
use crate::{
    TrainError,
    checkpoint::Journal,
    memory::{MemoryPlan, plan_memory},
    photos::{PhotoReader, ScaledPhoto},
    scoring::mean_psnr,
    split::{NamedFrame, Split, hold_out_by_place},
    views::{Begin, new_trainer, training_views},
};

/// All trials together take at most a fifth of the training's steps.
const PART: u64 = 5;
/// Least steps of a trial: fewer show only which configuration starts faster.
const LEAST_STEPS: u64 = 100;
/// Longest side of the grid of pixels of a photo that a trial is measured on: its render costs as much as 5 steps.
const SCORED_SIDE_PX: u32 = 128;
/// Photos are halved once more for trials, unless a side would fall below this, pixels.
const LEAST_SIDE_PX: u32 = 64;

/// What trials have decided.
pub(super) struct TrialResults {
    /// The configuration with the parts that pay.
    pub config: Config,
    pub trials: Vec<Trial>,
    /// Seconds that they took.
    pub seconds: f64,
}

/// Returns the plan's configuration with the parts that gain more than `least_gain_db`, and the reports of all trials.
///
/// A part whose key is set is left as it is. There are no trials at quality `draft`, with `fit = "fixed"`, where another training has
/// decided, or where steps or photos are too few.
pub(super) fn decide(
    ctx: &Ctx<'_>,
    params: &TrainParams,
    plan: &Plan<'_>,
) -> Result<TrialResults, StageError> {
    let began = Instant::now();
    let config = plan.settings.config.clone();
    let is_set = |part: &Part| {
        part.keys
            .iter()
            .find(|key| plan.settings.keys.0.contains_key(**key))
    };
    let open = PARTS.iter().filter(|part| is_set(part).is_none()).count() as u64;
    let steps = if plan.settings.is_decided() {
        0
    } else {
        steps_each(params, plan.settings.schedule.steps(), open)
    };
    let setup = match steps {
        0 => None,
        _ => TrialSetup::new(params, plan, steps)?,
    };
    let Some(mut setup) = setup else {
        return Ok(TrialResults {
            config,
            trials: Vec::new(),
            seconds: began.elapsed().as_secs_f64(),
        });
    };
    let mut journal = Journal::new(ctx, "trials", plan.identity);
    let base = setup.outcome(ctx, &mut journal, &config, "as it is")?;
    let (mut decided, mut trials) = (config.clone(), Vec::new());
    for part in &PARTS {
        if let Some(key) = is_set(part) {
            trials.push(not_tried(part, key));
            continue;
        }
        let (with, without) = ((part.with)(&config), (part.without)(&config));
        let other = if config == with { &without } else { &with };
        let other = setup.outcome(ctx, &mut journal, other, part.name)?;
        let pair = if config == with {
            [base, other]
        } else {
            [other, base]
        };
        let (trial, pays) = compared(part, pair, &setup, params.trials.least_gain_db);
        decided = if pays {
            (part.with)(&decided)
        } else {
            (part.without)(&decided)
        };
        trials.push(trial);
    }
    journal.end();
    Ok(TrialResults {
        config: decided,
        trials,
        seconds: began.elapsed().as_secs_f64(),
    })
}

/// Returns the steps left for the training where trials come out of the same budget.
pub(super) fn steps_after_trials(params: &TrainParams, steps: u64) -> u64 {
    match params.trials.steps {
        None if run_by_default(params) => (steps - steps / (PART + 1)).max(1),
        _ => steps,
    }
}

/// Returns whether trials run where `trials.steps` is not set.
fn run_by_default(params: &TrainParams) -> bool {
    params.quality != Quality::Draft && params.fit == Fit::Scene
}

/// Returns the steps of one trial where `open` parts are tried in addition to the configuration as it is. 0 means no trials.
fn steps_each(params: &TrainParams, steps: u64, open: u64) -> u64 {
    let share = steps / (PART * (open + 1));
    match params.trials.steps {
        _ if open == 0 || params.fit == Fit::Fixed => 0,
        Some(steps) => steps,
        None if run_by_default(params) && share >= LEAST_STEPS => share,
        None => 0,
    }
}

/// Returns the report of a part that a key decides.
fn not_tried(part: &Part, key: &str) -> Trial {
    Trial {
        part: part.name.to_owned(),
        with_db: None,
        without_db: None,
        parameters: None,
        steps: 0,
        decision: format!("not tried: `{key}` says so"),
    }
}

/// Mean PSNR and number of parameters of one configuration.
#[derive(Debug, Clone, Copy)]
struct Outcome {
    psnr: f64,
    parameters: u64,
}

/// Returns the trial as it is reported, and whether the part gains enough to be used.
fn compared(
    part: &Part,
    [with, without]: [Outcome; 2],
    setup: &TrialSetup<'_>,
    least_db: f64,
) -> (Trial, bool) {
    let gain_db = with.psnr - without.psnr;
    let pays = gain_db > least_db;
    let (word, relation) = if pays {
        ("kept", "more than")
    } else {
        ("left out", "not more than")
    };
    let decision = format!(
        "{word}: {gain_db:+.2} dB on {} validation photos after {} steps, {relation} {least_db} dB",
        setup.split.held_out.len(),
        setup.steps
    );
    let trial = Trial {
        part: part.name.to_owned(),
        with_db: Some(with.psnr),
        without_db: Some(without.psnr),
        parameters: Some(with.parameters.saturating_sub(without.parameters)),
        steps: setup.steps,
        decision,
    };
    (trial, pays)
}

impl Outcome {
    /// Bits of the PSNR and number of parameters, u64 LE.
    fn pack(self) -> Vec<u8> {
        [self.psnr.to_bits(), self.parameters]
            .map(u64::to_le_bytes)
            .concat()
    }

    /// Reads what [`Outcome::pack`] wrote.
    fn unpack(bytes: &[u8]) -> Option<Self> {
        let ([psnr, parameters], []) = bytes.as_chunks::<8>() else {
            return None;
        };
        Some(Self {
            psnr: f64::from_bits(u64::from_le_bytes(*psnr)),
            parameters: u64::from_le_bytes(*parameters),
        })
    }
}

/// What all trials of a training share.
struct TrialSetup<'a> {
    params: &'a TrainParams,
    plan: &'a Plan<'a>,
    split: Split<'a>,
    scale: u32,
    memory: MemoryPlan,
    steps: u64,
    /// Read for the first trial that is run.
    photos: Option<TrialPhotos<'a>>,
}

/// Photos that trials train on and are measured on.
struct TrialPhotos<'a> {
    views: Vec<View>,
    held_out: Vec<(NamedFrame<'a>, ScaledPhoto)>,
}

impl<'a> TrialSetup<'a> {
    /// Holds back one training photo in eight, by place. `None` if that leaves no photo to train on or to judge.
    fn new(params: &'a TrainParams, plan: &'a Plan<'a>, steps: u64) -> Result<Option<Self>, StageError> {
        let split = hold_out_by_place(plan.photos.split.training.clone(), &plan.photos.scene.points);
        if split.training.is_empty() || split.held_out.is_empty() {
            return Ok(None);
        }
        let (scale, times) = (scale(plan), vec![1; split.training.len()]);
        Ok(Some(Self {
            memory: plan_memory(params.memory, &split, &times, [scale; 2], &plan.settings.config)?,
            params,
            plan,
            split,
            scale,
            steps,
            photos: None,
        }))
    }

    /// Reads the photos.
    fn read(&self, ctx: &Ctx<'_>) -> Result<TrialPhotos<'a>, StageError> {
        let (split, times) = (&self.split, vec![1; self.split.training.len()]);
        let photos = PhotoReader::new(ctx, self.plan.photos.scene, self.scale);
        let thinned = |_, photo: ScaledPhoto| photo.thinned_to(SCORED_SIDE_PX);
        let scored = photos.map(&split.held_out, self.memory.at_once, thinned)?;
        Ok(TrialPhotos {
            views: training_views(&photos, &split.training, &times, self.memory, self.params.seed)?,
            held_out: split.held_out.iter().cloned().zip(scored).collect(),
        })
    }

    /// Returns the outcome of a configuration: that of an unfinished run if there is one.
    fn outcome(
        &mut self,
        ctx: &Ctx<'_>,
        journal: &mut Journal<'_>,
        config: &Config,
        name: &str,
    ) -> Result<Outcome, StageError> {
        journal.piece(Outcome::unpack, || {
            let outcome = self.run(ctx, config, name)?;
            Ok((outcome, outcome.pack()))
        })
    }

    /// Trains with `config` and measures it.
    fn run(&mut self, ctx: &Ctx<'_>, config: &Config, name: &str) -> Result<Outcome, StageError> {
        let photos = match self.photos.take() {
            Some(photos) => photos,
            None => self.read(ctx)?,
        };
        let photos = &*self.photos.insert(photos);
        let config = Config {
            steps: Some(self.steps),
            ..config.clone()
        };
        let scene = self.plan.photos.scene;
        let views = photos.views.clone();
        let mut trainer = new_trainer(views, scene, &config, Begin::Anew, self.params)?;
        let note = format!("trying {name}: ");
        let planner = Planner::new(Schedule::once(self.steps));
        let mut run = Run {
            note: &note,
            ..Run::new(planner, "trial", digest_of(&(self.plan.identity, name)))
        };
        train_to(ctx, &mut run, &mut trainer)?;
        let field = trainer.field().map_err(TrainError::from)?;
        Ok(Outcome {
            psnr: mean_psnr(ctx, &field, &photos.held_out)?,
            parameters: field.facts().parameters,
        })
    }
}

/// Returns the factor by which trials shrink photos.
fn scale(plan: &Plan<'_>) -> u32 {
    let cameras = plan.photos.split.training.iter().map(|named| &named.frame.camera);
    let shortest = cameras.map(|camera| camera.width.min(camera.height)).min();
    let halved = plan.settings.scale.saturating_mul(2);
    if shortest.unwrap_or(0) / halved < LEAST_SIDE_PX {
        return plan.settings.scale;
    }
    halved
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn params(value: serde_json::Value) -> TrainParams {
        serde_json::from_value(value).unwrap()
    }

    #[test]
    fn all_trials_together_take_at_most_a_fifth_of_the_steps() {
        for quality in ["standard", "best"] {
            let params = params(json!({ "quality": quality }));
            for (steps, open) in [(4_000, 4), (20_000, 4), (20_000, 1), (2_500, 4), (u64::MAX, 4)] {
                let each = steps_each(&params, steps, open);
                assert!(
                    each >= LEAST_STEPS && each <= steps / PART / (open + 1),
                    "{quality} {steps} {open}: {each}"
                );
            }
            assert_eq!(steps_each(&params, 2_499, 4), 0, "99 steps say nothing");
            assert_eq!(steps_each(&params, 4_000, 0), 0, "nothing is open");
        }
    }

    #[test]
    fn a_draft_and_a_fixed_field_try_nothing_unless_told() {
        for table in [
            json!({}),
            json!({"quality": "best", "fit": "fixed"}),
            json!({"quality": "best", "trials": {"steps": 0}}),
        ] {
            assert_eq!(steps_each(&params(table.clone()), 20_000, 4), 0, "{table}");
        }
        assert_eq!(steps_each(&params(json!({"trials": {"steps": 7}})), 20_000, 4), 7);
    }

    /// A budget pays for the trials, too, and the steps it leaves ask for the same trials again.
    #[test]
    fn a_budget_is_shared_between_training_and_trials() {
        let standard = params(json!({"quality": "standard"}));
        for paced in [1, 7, 3_000, 1_000_003] {
            let steps = steps_after_trials(&standard, paced);
            let all = steps + 5 * steps_each(&standard, steps, 4);
            assert!(
                steps >= 1 && all <= paced.max(1) && all * 10 >= paced * 8,
                "{paced}: {steps} of {all}"
            );
        }
        assert_eq!(steps_after_trials(&params(json!({})), 3_000), 3_000);
    }
}

//! Which parts of the field pay on this scene: short trainings, judged on photos that they do not see.

use marf_field::{
    Background, Config, Device, Field, Gain, Overrides, Quality, Trainer, Trial, View, ViewDependence,
};
use marf_scene::Scene;
use marf_schema::train::{Fit, TrainParams};
use marf_stage::{Ctx, StageError};

use crate::{
    TrainError,
    fit::shrunk,
    judge::mean_psnr,
    memory::plan,
    split::{Named, Reduced, Split, VALIDATION_EVERY, each_reduced, points, views},
};

/// All trials together take at most this part of the training's steps.
const PART: u64 = 5;
/// Fewer steps show only which side starts faster.
const LEAST_STEPS: u64 = 100;
/// Longest side of a photo that a trial is judged on, pixels: its render costs as much as 5 steps.
const JUDGED_SIDE_PX: u32 = 128;
/// Photos are halved once more for trials, unless a side would fall below this, pixels.
const LEAST_SIDE_PX: u32 = 64;

/// A part of the field, with and without.
struct Part {
    name: &'static str,
    /// A key that is set decides in place of the trial.
    keys: &'static [&'static str],
    with: fn(&Config) -> Config,
    without: fn(&Config) -> Config,
}

const PARTS: [Part; 4] = [
    Part {
        name: "view_dependence",
        keys: &["view_dependence"],
        with: |config| Config {
            view_dependence: ViewDependence::On,
            ..config.clone()
        },
        without: |config| Config {
            view_dependence: ViewDependence::Off,
            ..config.clone()
        },
    },
    Part {
        name: "gain",
        keys: &["gain"],
        with: |config| Config {
            gain: Gain::PerPhoto,
            ..config.clone()
        },
        without: |config| Config {
            gain: Gain::Off,
            ..config.clone()
        },
    },
    Part {
        name: "background",
        keys: &["background"],
        with: |config| Config {
            background: Background::Direction,
            ..config.clone()
        },
        without: |config| Config {
            background: Background::Black,
            ..config.clone()
        },
    },
    Part {
        name: "width",
        keys: &["density_width", "color_width", "color_layers"],
        // The width of quality `best` stays its own.
        with: |config| Config {
            density_width: match config.color_width {
                32 => 64,
                _ => config.density_width,
            },
            color_width: config.color_width.max(64),
            ..config.clone()
        },
        without: |config| Config {
            density_width: 32,
            color_width: 32,
            color_layers: 1,
            ..config.clone()
        },
    },
];

/// What a training is asked for.
pub(crate) struct Asked<'a> {
    pub scene: &'a Scene,
    pub split: &'a Split<'a>,
    pub scale: u32,
    /// Keys of the field that are set.
    pub keys: &'a Overrides,
    pub params: &'a TrainParams,
    /// Steps of the training itself.
    pub steps: u64,
}

/// Decides the parts whose keys are not set.
///
/// Returns `config` with the parts that gain more than `least_gain_db`, and every trial; none at quality `draft`,
/// with `fit = "fixed"`, or where steps or photos are too few.
pub(crate) fn decide(
    ctx: &Ctx<'_>,
    asked: &Asked<'_>,
    config: Config,
) -> Result<(Config, Vec<Trial>), StageError> {
    let is_set = |part: &Part| part.keys.iter().find(|key| asked.keys.0.contains_key(**key));
    let open = PARTS.iter().filter(|part| is_set(part).is_none()).count() as u64;
    let steps = steps_each(asked.params, asked.steps, open);
    let bench = match steps {
        0 => None,
        _ => Bench::new(ctx, asked, &config, steps)?,
    };
    let Some(bench) = bench else {
        return Ok((config, Vec::new()));
    };
    let base = bench.run(ctx, &config, "as it is")?;
    let (mut decided, mut trials) = (config.clone(), Vec::new());
    for part in &PARTS {
        if let Some(key) = is_set(part) {
            trials.push(not_tried(part, key));
            continue;
        }
        let (with, without) = ((part.with)(&config), (part.without)(&config));
        let other = if config == with { &without } else { &with };
        let other = bench.run(ctx, other, part.name)?;
        let pair = if config == with {
            [base, other]
        } else {
            [other, base]
        };
        let (trial, pays) = judged(part, pair, &bench, asked.params.trials.least_gain_db);
        decided = if pays {
            (part.with)(&decided)
        } else {
            (part.without)(&decided)
        };
        trials.push(trial);
    }
    Ok((decided, trials))
}

/// Returns the steps left for the training where trials come out of the same budget.
pub(crate) fn less_trials(params: &TrainParams, steps: u64) -> u64 {
    match params.trials.steps {
        None if are_wanted(params) => (steps - steps / (PART + 1)).max(1),
        _ => steps,
    }
}

fn are_wanted(params: &TrainParams) -> bool {
    params.quality != Quality::Draft && params.fit == Fit::Scene
}

/// Steps of one trial, `open` parts and the configuration as it is; 0 for none.
fn steps_each(params: &TrainParams, steps: u64, open: u64) -> u64 {
    let share = steps / (PART * (open + 1));
    match params.trials.steps {
        _ if open == 0 || params.fit == Fit::Fixed => 0,
        Some(steps) => steps,
        None if are_wanted(params) && share >= LEAST_STEPS => share,
        None => 0,
    }
}

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

/// Mean PSNR and trained numbers of one side.
#[derive(Debug, Clone, Copy)]
struct Outcome {
    psnr: f64,
    parameters: u64,
}

/// Tells whether the part pays, and the trial as it is told.
fn judged(part: &Part, [with, without]: [Outcome; 2], bench: &Bench<'_>, least_db: f64) -> (Trial, bool) {
    let gain_db = with.psnr - without.psnr;
    let pays = gain_db > least_db;
    let (word, relation) = if pays {
        ("kept", "more than")
    } else {
        ("left out", "not more than")
    };
    let decision = format!(
        "{word}: {gain_db:+.2} dB on {} validation photos after {} steps, {relation} {least_db} dB",
        bench.judges.len(),
        bench.steps
    );
    let trial = Trial {
        part: part.name.to_owned(),
        with_db: Some(with.psnr),
        without_db: Some(without.psnr),
        parameters: Some(with.parameters.saturating_sub(without.parameters)),
        steps: bench.steps,
        decision,
    };
    (trial, pays)
}

/// Photos to try on and to judge by.
struct Bench<'a> {
    views: Vec<View>,
    judges: Vec<(Named<'a>, Reduced)>,
    points: Vec<[f64; 3]>,
    device: Device,
    seed: u64,
    steps: u64,
}

impl<'a> Bench<'a> {
    /// Holds back every 8th training photo; `None` where that leaves none to train on.
    fn new(
        ctx: &Ctx<'_>,
        asked: &Asked<'a>,
        config: &Config,
        steps: u64,
    ) -> Result<Option<Self>, StageError> {
        let split = halves(&asked.split.training);
        if split.training.is_empty() {
            return Ok(None);
        }
        let (scale, times) = (scale(asked), vec![1; split.training.len()]);
        let plan = plan(asked.params.memory, &split, &times, scale, config)?;
        let small = |_, photo| shrunk(&photo, JUDGED_SIDE_PX);
        let photos = each_reduced(ctx, &split.held_out, scale, plan.at_once, small)?;
        Ok(Some(Self {
            views: views(ctx, &split, &times, scale, plan, asked.params.seed)?,
            judges: split.held_out.into_iter().zip(photos).collect(),
            points: points(asked.scene),
            device: asked.params.device.clone(),
            seed: asked.params.seed,
            steps,
        }))
    }

    fn run(&self, ctx: &Ctx<'_>, config: &Config, note: &str) -> Result<Outcome, StageError> {
        let config = Config {
            steps: Some(self.steps),
            ..config.clone()
        };
        let views = self.views.clone();
        let trainer = Trainer::new(views, &self.points, &config, self.seed);
        let trainer = trainer.and_then(|trainer| trainer.on(&self.device));
        let mut trainer = trainer.map_err(TrainError::from)?;
        while trainer.steps() < self.steps {
            ctx.check()?;
            trainer
                .advance(self.steps - trainer.steps())
                .map_err(TrainError::from)?;
            ctx.progress
                .at(trainer.steps(), self.steps, &format!("trying {note}"));
        }
        let field: Field = trainer.field().map_err(TrainError::from)?;
        Ok(Outcome {
            psnr: mean_psnr(ctx, &field, &self.judges)?,
            parameters: field.facts().parameters,
        })
    }
}

/// Splits training photos into those that judge trials, every 8th, and the others.
fn halves<'a>(training: &[Named<'a>]) -> Split<'a> {
    let numbered = training.iter().cloned().enumerate();
    let (judges, others): (Vec<_>, Vec<_>) = numbered.partition(|(index, _)| index % VALIDATION_EVERY == 0);
    let plain = |pairs: Vec<(usize, Named<'a>)>| pairs.into_iter().map(|(_, named)| named).collect();
    Split {
        training: plain(others),
        held_out: plain(judges),
    }
}

fn scale(asked: &Asked<'_>) -> u32 {
    let cameras = asked.split.training.iter().map(|named| &named.frame.camera);
    let shortest = cameras.map(|camera| camera.width.min(camera.height)).min();
    let halved = asked.scale.saturating_mul(2);
    if shortest.unwrap_or(0) / halved < LEAST_SIDE_PX {
        return asked.scale;
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
            let steps = less_trials(&standard, paced);
            let all = steps + 5 * steps_each(&standard, steps, 4);
            assert!(
                steps >= 1 && all <= paced.max(1) && all * 10 >= paced * 8,
                "{paced}: {steps} of {all}"
            );
        }
        assert_eq!(less_trials(&params(json!({})), 3_000), 3_000);
    }

    #[test]
    fn the_sides_of_a_part_differ_and_one_is_the_configuration_as_it_is() {
        for quality in [Quality::Draft, Quality::Standard, Quality::Best] {
            let config = quality.config();
            for part in &PARTS {
                let (with, without) = ((part.with)(&config), (part.without)(&config));
                assert_ne!(with, without, "{quality:?} {}", part.name);
                assert!(config == with || config == without, "{quality:?} {}", part.name);
                with.check().and(without.check()).unwrap();
            }
        }
    }
}

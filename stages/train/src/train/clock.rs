//! A training by the clock: how many steps its time is for, planned anew as the time goes.

use std::time::Instant;

use marf_field::{Config, Pace, Schedule, Trainer};
use marf_schema::train::{Limit, TrainParams};
use marf_stage::{Ctx, StageError};
use serde::{Deserialize, Serialize};

use super::{
    Plan,
    foreseen::{JUDGED_SHARE, Judging, kept_s, steps_in},
    trials,
};
use crate::{
    TrainError, checkpoint,
    photos::PhotoReader,
    views::{new_trainer, training_views},
};

/// Part of the time after which the end is planned anew.
const PLANNED_EVERY: f64 = 1.0 / 32.0;
/// A plan that would move the end by no more than this share of the steps left is not made.
const LEAST_CHANGE: f64 = 0.01;
/// How much the rate since the last plan counts beside those before it.
const NEWEST: f64 = 0.5;
/// Steps before which a field is a fog, whose renders tell nothing of those at the end.
const CLEAR_AT: u64 = 1_280;
/// Part of the time after which judging is measured again, where it is part of the same time.
const JUDGED_EVERY: f64 = 1.0 / 12.0;
/// Part of the photos' pixels that a training should see at least: photos are shrunk further until it does. Mock-up, 80 photos, judged
/// at 720 x 960 pixels: 700 steps are .3 dB better on photos of 180 x 240 (a fifth seen) than of 360 x 480 (a twentieth), 1,400 steps
/// .3 dB worse.
const LEAST_SEEN: f64 = 1.0 / 12.0;
/// Longest side below which photos are not shrunk for that, pixels.
const LEAST_SIDE_PX: u32 = 160;
/// Part of a checkpoint that holds what the pilot found.
const PART: &str = "pilot";

/// The time of a training: what it may take, and what of it is used.
#[derive(Debug, Clone, Copy)]
pub(super) struct Clock {
    budget_s: f64,
    used_s: f64,
    /// Where judging is part of the same time.
    wait: Option<Wait>,
}

/// What is known of judging that is part of the same time as the training.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Wait {
    /// Seconds of the whole wait.
    whole_s: f64,
    /// Photos that could be judged.
    photos: usize,
    /// Seconds kept for judging them, or as many as there is time for.
    judging_s: f64,
    /// Seconds used when that was, and after how many more it is measured again.
    at_s: f64,
    every_s: f64,
}

/// The clock of a training as a checkpoint keeps it, with the schedule that it made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Clocked {
    /// Seconds of the training, all in all and used so far.
    pub budget_s: f64,
    pub used_s: f64,
    wait: Option<Wait>,
    /// The schedule so far.
    pub schedule: Schedule,
}

/// What a pilot found.
#[derive(Serialize, Deserialize)]
struct Pilot {
    /// Seconds of the training, as far as the pilot could tell what comes before and after it.
    budget_s: f64,
    steps: u64,
    /// Samples of a step: those that suit the device.
    batch_samples: u32,
    /// Whole factor by which photos are shrunk.
    scale: u32,
    used_s: f64,
    wait: Option<Wait>,
    /// Seconds of the whole node, as foreseen.
    expected_s: f64,
}

impl Clock {
    /// Trains for a moment to find how many steps the time is for, and plans for so many and for photos of the size that they can
    /// see; the field of the pilot is lost.
    pub fn paced(
        ctx: &Ctx<'_>,
        (params, limit): (&TrainParams, Limit),
        plan: &mut Plan<'_>,
        photos: &PhotoReader<'_>,
    ) -> Result<Self, StageError> {
        let saved = checkpoint::load(ctx, PART, &plan.of);
        let pilot = match saved.and_then(|saved| serde_json::from_slice(&saved).ok()) {
            Some(pilot) => pilot,
            None => {
                let pilot = Pilot::run(ctx, (params, limit), plan, photos)?;
                // Numbers always serialise.
                let saved = serde_json::to_vec(&pilot).unwrap_or_default();
                checkpoint::save(ctx, PART, &plan.of, &saved);
                pilot
            }
        };
        let Pilot {
            budget_s,
            steps,
            batch_samples,
            scale,
            used_s,
            wait,
            expected_s,
        } = pilot;
        ctx.progress.took("expected", expected_s);
        let note = format!("about {expected_s:.0} s, {budget_s:.0} s of them training");
        ctx.progress.at(0, steps, &note);
        let steps = match plan.settings.is_decided() {
            true => steps,
            false => trials::steps_after_trials(params, steps),
        };
        plan.settings.plan_steps(steps, batch_samples);
        plan.shrink_by(scale)?;
        Ok(Self {
            budget_s,
            used_s,
            wait,
        })
    }

    /// Returns the clock after so many further seconds.
    pub fn after(self, seconds: f64) -> Self {
        Self {
            used_s: self.used_s + seconds,
            ..self
        }
    }

    /// Goes on where a checkpoint was made.
    pub fn resume(&mut self, clocked: &Clocked) {
        *self = Self {
            budget_s: clocked.budget_s,
            used_s: clocked.used_s,
            wait: clocked.wait,
        };
    }

    /// Starts the clock of the steps.
    pub fn start(self, steps: u64) -> Ticking {
        Ticking {
            clock: self,
            begun: Instant::now(),
            looked: (steps, self.used_s),
            rate: None,
        }
    }
}

impl Pilot {
    fn run(
        ctx: &Ctx<'_>,
        (params, limit): (&TrainParams, Limit),
        plan: &Plan<'_>,
        photos: &PhotoReader<'_>,
    ) -> Result<Self, StageError> {
        let read = Instant::now();
        let views = || training_views(photos, &plan.split.training, plan.times, plan.memory, params.seed);
        let trainer = |config: &Config| {
            let (seed, begin) = (params.seed, plan.begin());
            new_trainer(views()?, plan.scene, config, seed, begin, &params.device).map_err(StageError::from)
        };
        let config = &plan.settings.config;
        let mut first = trainer(config)?;
        let read_s = read.elapsed().as_secs_f64();
        let begun = Instant::now();
        let open_s = || match limit {
            Limit::Training(budget) => budget.seconds() - begun.elapsed().as_secs_f64(),
            Limit::Wait(wait) => (wait.seconds() - ctx.began.elapsed().as_secs_f64()) * (1.0 - JUDGED_SHARE),
        };
        let measured_s = Pace::measured_s(limit.seconds());
        let rates = paced(ctx, &mut first, (measured_s, plan))?;
        let measured = |steps: u64| {
            let steps = Some(steps);
            let mut trainer = trainer(&Config {
                steps,
                ..config.clone()
            })?;
            let pace = train_for(ctx, &mut trainer, measured_s / 2.0)?;
            Ok::<_, StageError>((trainer, pace))
        };
        let (trainer, rates) = match plan.settings.is_decided() {
            true => (first, rates),
            false => rates.settled(
                first,
                limit.seconds(),
                |rates| steps_in(open_s(), rates.steps),
                measured,
            )?,
        };
        let batch_samples = trainer.batch_samples();
        let (rate, used_s, open_s) = (rates.steps, begun.elapsed().as_secs_f64(), open_s());
        let judging = Judging::foreseen(plan, &trainer, &rates);
        drop(trainer);
        let scale = match params.scale {
            Some(scale) => scale,
            None => plan.settings.scale.max(plan.scale_for(rates.rays * open_s)),
        };
        // The training reads its photos anew; if they keep their size, they were shrunk by now.
        let again_s = match scale == plan.settings.scale {
            true => {
                let read = Instant::now();
                drop(views()?);
                read.elapsed().as_secs_f64()
            }
            false => read_s,
        };
        let (budget_s, judging_s) = match limit {
            Limit::Training(budget) => {
                let steps = steps_in(budget.seconds() - used_s, rate);
                (budget.seconds(), judging.all_s(steps))
            }
            Limit::Wait(wait) => {
                let left_s = wait.seconds() - ctx.began.elapsed().as_secs_f64() - again_s;
                let (steps, judging_s) = judging.most_steps(wait.seconds(), (left_s, rate))?;
                (used_s + steps as f64 / rate, judging_s)
            }
        };
        Ok(Self {
            budget_s,
            steps: steps_in(budget_s - used_s, rate),
            batch_samples,
            scale,
            used_s,
            wait: matches!(limit, Limit::Wait(_)).then_some(Wait {
                whole_s: limit.seconds(),
                photos: judging.held_out,
                judging_s,
                at_s: used_s,
                every_s: limit.seconds() * JUDGED_EVERY,
            }),
            expected_s: read_s + again_s + budget_s + judging_s,
        })
    }
}

impl Plan<'_> {
    /// Returns the least factor by which photos must be shrunk for so many rays to see the least part of them.
    fn scale_for(&self, rays: f64) -> u32 {
        let cameras = self.split.training.iter().map(|named| &named.frame.camera);
        scale_for(cameras.map(|camera| [camera.width, camera.height]), rays)
    }

    /// Plans for photos of another size.
    fn shrink_by(&mut self, scale: u32) -> Result<(), TrainError> {
        self.settings.scale = scale;
        self.memory = self
            .settings
            .plan_memory(self.split, self.times, self.judging.scale)?;
        Ok(())
    }
}

/// Returns the least factor by which photos of these sizes must be shrunk for so many rays to see the least part of their pixels.
fn scale_for(sizes_px: impl Iterator<Item = [u32; 2]> + Clone, rays: f64) -> u32 {
    let longest = sizes_px.clone().map(|[width, height]| width.max(height)).max();
    let most = (longest.unwrap_or(0) / LEAST_SIDE_PX).max(1);
    let pixels: f64 = sizes_px
        .map(|[width, height]| f64::from(width) * f64::from(height))
        .sum();
    // Without any ray the factor is infinite, and the largest number.
    let wanted = (LEAST_SEEN * pixels / rays.max(0.0)).sqrt();
    (wanted.ceil() as u32).clamp(1, most)
}

/// Trains for a time and returns the pace of its second half, with the batch that suits the device where none is said or taken
/// over.
fn paced(
    ctx: &Ctx<'_>,
    trainer: &mut Trainer,
    (seconds, plan): (f64, &Plan<'_>),
) -> Result<Pace, StageError> {
    let half_s = seconds / 2.0;
    train_for(ctx, trainer, half_s)?;
    let mut pace = train_for(ctx, trainer, half_s)?;
    if !plan.settings.has_open_batch() {
        return Ok(pace);
    }
    for _ in 0..Pace::MOST_CHANGES {
        if !trainer.suit(&pace).map_err(TrainError::from)? {
            break;
        }
        pace = train_for(ctx, trainer, half_s)?;
    }
    Ok(pace)
}

/// Trains for a time, at least one step, and returns what it does in a second.
fn train_for(ctx: &Ctx<'_>, trainer: &mut Trainer, seconds: f64) -> Result<Pace, StageError> {
    let (begun, before) = (Instant::now(), trainer.steps());
    // A slow device may need longer for sixteen steps, which a GPU takes at once, than the time is.
    let (mut rays, mut samples, mut most) = (0, 0, 1_u64);
    loop {
        ctx.check()?;
        let step = trainer.advance(most).map_err(TrainError::from)?;
        (rays, samples, most) = (rays + step.rays, samples + step.samples, most.saturating_mul(2));
        if begun.elapsed().as_secs_f64() >= seconds {
            let last = trainer.settle().map_err(TrainError::from)?;
            (rays, samples) = (rays + last.rays, samples + last.samples);
            let elapsed_s = begun.elapsed().as_secs_f64();
            let [steps, rays, samples] =
                [trainer.steps() - before, rays, samples].map(|count| count as f64 / elapsed_s);
            return Ok(Pace { steps, rays, samples });
        }
    }
}

/// A clock that runs.
pub(super) struct Ticking {
    clock: Clock,
    begun: Instant,
    /// Steps and seconds when the end was last planned.
    looked: (u64, f64),
    /// Steps a second, as far as they were seen.
    rate: Option<f64>,
}

impl Ticking {
    /// Returns the seconds used so far.
    fn used_s(&self) -> f64 {
        self.clock.used_s + self.begun.elapsed().as_secs_f64()
    }

    /// Returns what a checkpoint keeps of it.
    pub fn clocked(&self, schedule: &Schedule) -> Clocked {
        Clocked {
            budget_s: self.clock.budget_s,
            used_s: self.used_s(),
            wait: self.clock.wait,
            schedule: schedule.clone(),
        }
    }

    /// Tells whether judging is to be measured again: it takes longer with every halving of the steps along rays.
    pub fn is_to_judge(&self, steps: u64) -> bool {
        let is_due = |wait: Wait| steps >= CLEAR_AT && self.used_s() - wait.at_s > wait.every_s;
        self.clock.wait.is_some_and(is_due)
    }

    /// Keeps time for judging, where a photo takes so many seconds.
    pub fn leave(&mut self, photo_s: f64) {
        let used_s = self.used_s();
        if let Some(wait) = &mut self.clock.wait {
            let judging_s = kept_s(photo_s, wait.photos, wait.whole_s);
            self.clock.budget_s += wait.judging_s - judging_s;
            (wait.judging_s, wait.at_s) = (judging_s, used_s);
        }
    }

    /// Plans the end of a training anew if it is time to and it has not come.
    pub fn plan(&mut self, trainer: &mut Trainer) {
        let (steps, end) = (trainer.steps(), trainer.schedule().steps());
        let planned = (steps < end).then(|| self.end(steps, end, self.used_s()));
        if let Some(end) = planned.flatten() {
            trainer.plan(end);
        }
    }

    /// Returns the new end of a training that was to end after `end` steps, if it should be moved.
    fn end(&mut self, steps: u64, end: u64, used_s: f64) -> Option<u64> {
        let left_s = self.clock.budget_s - used_s;
        if left_s <= 0.0 {
            return (steps + 1 < end).then_some(steps + 1);
        }
        let (before, since_s) = (self.looked.0, used_s - self.looked.1);
        if since_s < self.clock.budget_s * PLANNED_EVERY || steps == before {
            return None;
        }
        let newest = (steps - before) as f64 / since_s;
        let rate = self
            .rate
            .map_or(newest, |rate| NEWEST * newest + (1.0 - NEWEST) * rate);
        self.looked = (steps, used_s);
        self.rate = Some(rate);
        let planned = steps + steps_in(left_s, rate);
        let change = planned.abs_diff(end) as f64;
        (change > LEAST_CHANGE * (end.saturating_sub(steps)) as f64).then_some(planned)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ticking(budget_s: f64) -> Ticking {
        Clock {
            budget_s,
            used_s: 0.0,
            wait: None,
        }
        .start(0)
    }

    /// Of 64 s, looked at every 2 s: 100 steps a second as planned change nothing; half as many move the end by what is left
    /// at the mean of both rates, and the time that is over ends it with the next step.
    #[test]
    fn the_end_follows_the_rate_and_the_time_that_is_left() {
        let mut clock = ticking(64.0);
        assert_eq!(clock.end(100, 6_400, 1.0), None, "too early");
        assert_eq!(clock.end(200, 6_400, 2.0), None, "as planned");
        assert_eq!(clock.end(300, 6_400, 4.0), Some(300 + 75 * 60));
        assert_eq!(clock.end(300, 4_800, 9.0), None, "no step since");
        assert_eq!(clock.end(4_000, 4_800, 64.0), Some(4_001));
        assert_eq!(clock.end(4_001, 4_001, 65.0), None);
        let mut clock = ticking(64.0);
        assert_eq!(
            clock.end(201, 6_400, 2.0),
            None,
            "less than a hundredth of what is left"
        );
    }

    /// 80 photos of 1440 x 1920 pixels are 221.184 million, a twelfth of them 18.432: a tenth of that as rays asks for a tenth of the
    /// pixels, so for photos shrunk by 3.2.
    #[test]
    fn photos_are_shrunk_until_the_rays_see_a_part_of_them() {
        let photos = |side: u32| [[side * 3 / 4, side]; 80].into_iter();
        assert_eq!(scale_for(photos(1920), 1.8432e6), 4);
        assert_eq!(scale_for(photos(1920), 18.432e6), 1);
        assert_eq!(scale_for(photos(1920), 18e6), 2);
        assert_eq!(scale_for(photos(1920), 1e12), 1);
        let least_side = scale_for(photos(1920), 0.0);
        assert_eq!((least_side, scale_for(photos(1920), f64::NAN)), (12, 12));
        assert_eq!(
            [scale_for(photos(100), 0.0), scale_for([].into_iter(), 9.0)],
            [1, 1]
        );
    }

    /// Whatever the rate does, a training ends within a tenth of its time; only one that becomes faster at the end ends early.
    #[test]
    fn a_training_ends_with_its_time_at_any_rate() {
        let rates: [fn(f64) -> f64; 4] = [
            |_| 90.0,
            |used_s| if used_s < 30.0 { 200.0 } else { 40.0 },
            |used_s| if used_s < 55.0 { 20.0 } else { 120.0 },
            |used_s| {
                if (used_s as u64).is_multiple_of(7) {
                    5.0
                } else {
                    150.0
                }
            },
        ];
        for (at, rate) in rates.into_iter().enumerate() {
            let (mut clock, mut end, mut steps, mut used_s) = (ticking(60.0), 100_000, 0, 0.0);
            while steps < end {
                used_s += 1.0 / rate(used_s);
                steps += 1;
                end = clock.end(steps, end, used_s).unwrap_or(end);
            }
            assert!((55.0..=60.5).contains(&used_s), "rate {at}: {used_s} s");
        }
    }
}

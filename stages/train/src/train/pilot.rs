//! Measures a training by the clock before it begins: the number of steps for its time, the samples of a step and the size of the photos.

use std::time::Instant;

use marf_field::{Config, FieldError, Pace, Trainer, steps_in};
use marf_schema::train::{Limit, TrainParams};
use marf_stage::{Ctx, StageError};
use serde::{Deserialize, Serialize};

use super::{
    photo_set::PhotoSet,
    plan::Plan,
    planner::{JUDGED_SHARE, JudgingCost, JudgingReserve, TrainingTime},
};
use crate::{
    TrainError, checkpoint,
    photos::PhotoReader,
    views::{new_trainer, training_views},
};

/// Part of the photos' pixels that a training should see at least. Photos are shrunk further until it does. Mock-up, 80 photos, judged at
/// 720 x 960 pixels: 700 steps are 0.3 dB better on photos of 180 x 240 (a fifth seen) than of 360 x 480 (a twentieth). 1,400 steps are 0.3
/// dB worse.
const LEAST_SEEN: f64 = 1.0 / 12.0;
/// Longest side below which photos are not shrunk for that, pixels.
const LEAST_SIDE_PX: u32 = 160;
/// Part of a checkpoint that holds what the pilot found.
const PART: &str = "pilot";

/// What a pilot found.
#[derive(Serialize, Deserialize)]
struct PilotResult {
    /// The time of the training, as far as the pilot could foresee what comes before and after it.
    time: TrainingTime,
    steps: u64,
    /// Samples of a step: those that suit the device.
    batch_samples: u32,
    /// Whole factor by which photos are shrunk.
    scale: u32,
    /// Seconds of the whole node, as foreseen.
    expected_s: f64,
}

/// Trains for a moment to find how many steps fit the time, and plans for these steps and for photos of a matching size. The field of the
/// pilot is lost. A training without a time stays as planned.
///
/// # Errors
/// Those of a training, or a wait that leaves no time for one.
pub(super) fn plan_by_time(
    ctx: &Ctx<'_>,
    params: &TrainParams,
    plan: &mut Plan<'_>,
    photos: &PhotoReader<'_>,
) -> Result<(), StageError> {
    let Some(limit) = params.limit() else {
        return Ok(());
    };
    let saved = checkpoint::load(ctx, PART, &plan.identity);
    let found = match saved.and_then(|saved| serde_json::from_slice(&saved).ok()) {
        Some(found) => found,
        None => {
            let found = PilotResult::measure(ctx, params, limit, plan, photos)?;
            // Numbers always serialise.
            let saved = serde_json::to_vec(&found).unwrap_or_default();
            checkpoint::save(ctx, PART, &plan.identity, &saved);
            found
        }
    };
    let PilotResult {
        time,
        steps,
        batch_samples,
        scale,
        expected_s,
    } = found;
    ctx.progress.took("expected", expected_s);
    let note = format!("about {expected_s:.0} s, {:.0} s of them training", time.budget_s);
    ctx.progress.at(0, steps, &note);
    plan.settings.plan_steps(steps, batch_samples);
    plan.shrink_by(scale)?;
    plan.time = Some(time);
    Ok(())
}

impl PilotResult {
    fn measure(
        ctx: &Ctx<'_>,
        params: &TrainParams,
        limit: Limit,
        plan: &Plan<'_>,
        photos: &PhotoReader<'_>,
    ) -> Result<Self, StageError> {
        let PhotoSet {
            split, times, scene, ..
        } = &plan.photos;
        let views = || {
            training_views(photos, &split.training, times, plan.memory, params.seed)
                .map(|views| plan.distances.give_to(views))
        };
        let trainer = |config: &Config| {
            new_trainer(views()?, scene, config, plan.begin(), params).map_err(StageError::from)
        };
        let config = &plan.settings.config;
        let read = Instant::now();
        let first = trainer(config)?;
        let read_s = read.elapsed().as_secs_f64();
        let began = Instant::now();
        let left_s = || match limit {
            Limit::Training(budget) => budget.seconds() - began.elapsed().as_secs_f64(),
            Limit::Wait(wait) => (wait.seconds() - ctx.began.elapsed().as_secs_f64()) * (1.0 - JUDGED_SHARE),
        };
        let pilot = marf_field::Pilot {
            seconds: limit.seconds(),
            open: plan.settings.open_sizes(),
            new_trainer: &trainer,
            left_s: &left_s,
            check: &|| ctx.check(),
            failed: |error: FieldError| TrainError::from(error).into(),
        };
        let (trainer, pace) = pilot.run(first, config)?;
        let batch_samples = trainer.batch_samples();
        let (used_s, open_s) = (began.elapsed().as_secs_f64(), left_s());
        let judging = judging_cost(plan, &trainer, &pace);
        drop(trainer);
        let scale = params
            .scale
            .unwrap_or_else(|| plan.settings.scale.max(scale_for_rays(plan, pace.rays * open_s)));
        // The training reads its photos again. If they keep their size, they are already shrunk.
        let read_again_s = if scale == plan.settings.scale {
            let read = Instant::now();
            drop(views()?);
            read.elapsed().as_secs_f64()
        } else {
            read_s
        };
        let (budget_s, judging_s) = match limit {
            Limit::Training(budget) => {
                let steps = steps_in(budget.seconds() - used_s, pace.steps);
                (budget.seconds(), judging.all_s(steps))
            }
            Limit::Wait(wait) => {
                let rest_s = wait.seconds() - ctx.began.elapsed().as_secs_f64() - read_again_s;
                let (steps, judging_s) = judging.most_steps(wait.seconds(), rest_s, pace.steps)?;
                (used_s + steps as f64 / pace.steps, judging_s)
            }
        };
        let reserve = || JudgingReserve::new(limit.seconds(), judging.held_out, judging_s, used_s);
        Ok(Self {
            time: TrainingTime {
                budget_s,
                used_s,
                reserve: matches!(limit, Limit::Wait(_)).then(reserve),
            },
            steps: steps_in(budget_s - used_s, pace.steps),
            batch_samples,
            scale,
            expected_s: read_s + read_again_s + budget_s + judging_s,
        })
    }
}

/// Returns the expected cost of judging, at the pace of a training that has just begun.
fn judging_cost(plan: &Plan<'_>, trainer: &Trainer, pace: &Pace) -> JudgingCost {
    let held_out = plan.photos.split.held_out.len();
    let earlier = plan.start.field.as_ref();
    JudgingCost {
        unhalved_s: JudgingCost::unhalved_s(plan.judged_rays(), pace.samples),
        first_halvings: earlier.map_or(0, |field| field.facts().halvings),
        most_halvings: trainer.most_halvings(),
        held_out: held_out.min(plan.judging.photos.most.unwrap_or(held_out)),
        seen: plan.seen().map_or(0, |seen| seen.len()),
    }
}

/// Returns the least factor by which photos must be shrunk for `rays` to see the least part of them.
fn scale_for_rays(plan: &Plan<'_>, rays: f64) -> u32 {
    let training = plan.photos.split.training.iter();
    let cameras = training.map(|named| &named.frame.camera);
    scale_for(cameras.map(|camera| [camera.width, camera.height]), rays)
}

/// Returns the least factor by which photos of these sizes must be shrunk for `rays` to see the least part of their pixels.
fn scale_for(sizes_px: impl Iterator<Item = [u32; 2]> + Clone, rays: f64) -> u32 {
    let longest = sizes_px.clone().map(|[width, height]| width.max(height)).max();
    let most = (longest.unwrap_or(0) / LEAST_SIDE_PX).max(1);
    let pixels: f64 = sizes_px
        .map(|[width, height]| f64::from(width) * f64::from(height))
        .sum();
    // Without any ray the factor is infinite, and the largest number.
    let factor = (LEAST_SEEN * pixels / rays.max(0.0)).sqrt();
    (factor.ceil() as u32).clamp(1, most)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 80 photos of 1440 x 1920 pixels are 221.184 million, a twelfth of them 18.432. A tenth of that as rays needs a tenth of the pixels,
    /// so photos shrunk by 3.2.
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
}

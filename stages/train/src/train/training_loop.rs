use std::ops::Range;
use std::time::{Duration, Instant};

use marf_cache::Digest;
use marf_field::{Schedule, Trainer};
use marf_schema::train::Curve;
use marf_stage::{Ctx, StageError};

use super::{
    log::{TrainingLog, packed_state, unpack},
    planner::Planner,
};
use crate::{
    TrainError,
    checkpoint::{self, SAVE_EVERY},
    photos::{PhotoReader, ScaledPhoto},
    scoring::mean_psnr,
    split::NamedFrame,
};

/// Wall clock between two reports of progress.
const REPORT_EVERY: Duration = Duration::from_millis(200);

/// A training: how far it goes, where its state is kept, and what it is called.
pub(crate) struct Run<'a> {
    /// Decides after how many steps it ends.
    pub planner: Planner<'a>,
    /// The state that it begins with, as [`packed_state`] returns it. `None` for step 0.
    pub from: Option<&'a [u8]>,
    /// Name of the checkpoint.
    pub part: &'a str,
    /// What the checkpoint is of.
    pub identity: Digest,
    /// Photos that the curve is measured on. Without any there is no curve.
    pub curve_photos: &'a [(NamedFrame<'a>, ScaledPhoto)],
}

impl<'a> Run<'a> {
    /// Returns a training without curve from step 0.
    pub fn new(planner: Planner<'a>, part: &'a str, identity: Digest) -> Self {
        Self {
            planner,
            from: None,
            part,
            identity,
            curve_photos: &[],
        }
    }
}

/// Trains from the last checkpoint, or the state that the run begins with, up to the step after which it stops.
///
/// # Errors
/// A state of another training or of a later step, or a step that fails.
pub(crate) fn train_to(
    ctx: &Ctx<'_>,
    run: &mut Run<'_>,
    trainer: &mut Trainer,
) -> Result<TrainingLog, StageError> {
    trainer.follow(run.planner.schedule.clone());
    let mut log = begin(ctx, run, trainer)?;
    run.planner.start(&log.planner, trainer);
    let mut saved_at = Instant::now();
    let mut reported: Option<Instant> = None;
    loop {
        let looked = ctx.check().and_then(|()| look(ctx, run, trainer, &mut log));
        let end = run.planner.end(trainer);
        run.planner.record(trainer, &mut log.planner);
        match looked {
            Err(stopped) => {
                log.settle(trainer)?;
                save(ctx, run, &log, trainer)?;
                return Err(stopped);
            }
            Ok(has_target) if has_target || trainer.steps() >= end => {
                log.settle(trainer)?;
                return Ok(log);
            }
            Ok(_) => {}
        }
        log.measured = trainer.steps();
        let step = trainer.advance(end - log.measured).map_err(TrainError::from)?;
        log.add(&step);
        run.planner.replan(trainer)?;
        if reported.is_none_or(|at| at.elapsed() >= REPORT_EVERY) {
            let note = log.note(&run.planner.note(&log.planner), &step);
            let steps = trainer.steps();
            ctx.progress.at(steps, end.max(steps), &note);
            reported = Some(Instant::now());
        }
        if saved_at.elapsed() >= SAVE_EVERY {
            run.planner.record(trainer, &mut log.planner);
            log.settle(trainer)?;
            save(ctx, run, &log, trainer)?;
            saved_at = Instant::now();
        }
    }
}

/// Measures the points and looks that are due after the last steps, and returns whether the field has the target.
fn look(
    ctx: &Ctx<'_>,
    run: &Run<'_>,
    trainer: &mut Trainer,
    log: &mut TrainingLog,
) -> Result<bool, StageError> {
    let taken = log.measured..trainer.steps();
    let schedule = trainer.schedule().clone();
    let is_point = !run.curve_photos.is_empty() && is_curve_point(&taken, &schedule);
    let is_target_due = run.planner.is_target_due(&taken, &schedule);
    if taken.is_empty() || !(is_point || is_target_due) {
        return Ok(false);
    }
    log.settle(trainer)?;
    let field = trainer.field().map_err(TrainError::from)?;
    let planner = &run.planner;
    let has_target = is_target_due && planner.look(ctx, &mut log.planner, &field, &schedule, taken.end)?;
    if is_point || has_target {
        log.point(taken.end, mean_psnr(ctx, &field, run.curve_photos)?);
    }
    log.measured = taken.end;
    Ok(has_target)
}

/// Reads all held-out photos and returns up to three, evenly spaced and thinned, to measure the curve on. A photo that cannot be read stops
/// a training before it begins.
pub(crate) fn curve_photos<'a>(
    photos: &PhotoReader<'_>,
    held_out: &[NamedFrame<'a>],
    at_once: usize,
) -> Result<Vec<(NamedFrame<'a>, ScaledPhoto)>, StageError> {
    let count = held_out.len().min(Curve::MOST_PHOTOS);
    let places: Vec<usize> = (0..count).map(|photo| photo * held_out.len() / count).collect();
    let thinned =
        |index: usize, photo: ScaledPhoto| places.contains(&index).then(|| photo.thinned_to(Curve::SIDE_PX));
    let read = photos.map(held_out, at_once, thinned)?;
    let pairs = held_out.iter().zip(read);
    Ok(pairs
        .filter_map(|(named, photo)| Some((named.clone(), photo?)))
        .collect())
}

/// Returns whether a point of the curve falls among the steps taken: at 1/16 of all steps and at every eighth.
fn is_curve_point(taken: &Range<u64>, schedule: &Schedule) -> bool {
    let (before, after) = (schedule.done(taken.start), schedule.done(taken.end));
    let crosses = |parts: f64| (after * parts).floor() > (before * parts).floor();
    crosses(8.0) || (crosses(16.0) && before < 1.0 / 8.0)
}

/// Puts the trainer where the last checkpoint was, or else at the state that the run begins with, and returns the log of that
/// moment.
fn begin(ctx: &Ctx<'_>, run: &Run<'_>, trainer: &mut Trainer) -> Result<TrainingLog, TrainError> {
    let saved = checkpoint::load(ctx, run.part, &run.identity);
    if let Some((mut log, state)) = saved.as_deref().and_then(unpack::<TrainingLog>)
        && trainer.restore(state).is_ok()
    {
        log.resumed_at = trainer.steps();
        return Ok(log);
    }
    let Some(from) = run.from else {
        return Ok(TrainingLog::default());
    };
    let unreadable = || TrainError::State("it is cut, or no state of a training".to_owned());
    let (log, state) = unpack::<TrainingLog>(from).ok_or_else(unreadable)?;
    let restored = trainer.restore(state);
    restored.map_err(|error| TrainError::State(error.to_string()))?;
    let until = run.planner.until.unwrap_or(run.planner.schedule.steps());
    match trainer.steps() {
        at if at > until => Err(TrainError::Behind { at, until }),
        _ => Ok(log),
    }
}

/// Saves a checkpoint. The log must be settled.
pub(crate) fn save(
    ctx: &Ctx<'_>,
    run: &Run<'_>,
    log: &TrainingLog,
    trainer: &mut Trainer,
) -> Result<(), TrainError> {
    checkpoint::save(ctx, run.part, &run.identity, &packed_state(log, trainer)?);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_has_nine_points_at_fixed_shares_of_the_steps() {
        for steps in [16_u64, 100, 401, 20_000] {
            let points: Vec<u64> = (1..=steps)
                .filter(|step| is_curve_point(&(*step - 1..*step), &Schedule::once(steps)))
                .collect();
            assert_eq!(points.len(), 9, "{steps}: {points:?}");
            assert_eq!((points[0], points[8]), (steps.div_ceil(16), steps));
        }
        for steps in 1..16 {
            let points: Vec<u64> = (1..=steps)
                .filter(|step| is_curve_point(&(*step - 1..*step), &Schedule::once(steps)))
                .collect();
            assert_eq!(points.last(), Some(&steps), "{points:?}");
        }
    }
}

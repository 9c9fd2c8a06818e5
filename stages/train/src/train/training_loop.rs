use std::ops::Range;
use std::time::{Duration, Instant};

use marf_cache::Digest;
use marf_field::{Schedule, Trainer};
use marf_schema::train::{Curve, CurvePoint};
use marf_stage::{Ctx, StageError};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{
    clock::{Clock, Clocked, Ticking},
    goal::{Goal, Watched},
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
/// Photos that the curve is measured on, and their longest side in pixels: nine points cost a tenth of a draft.
const CURVE_PHOTOS: usize = 3;
const CURVE_SIDE_PX: u32 = 64;

/// Measures the seconds that judging a photo will take when the field is trained.
type JudgingTime<'a> = dyn Fn(&mut Trainer) -> Result<f64, StageError> + 'a;

/// A training: how far it goes, where its state is kept, and what it is called.
pub(crate) struct Run<'a> {
    /// After how many steps it ends; a clock plans that anew on its way.
    pub schedule: Schedule,
    /// Steps after which it stops before; none: it goes to its end.
    pub until: Option<u64>,
    /// The state that it begins with, as [`packed_state`] returns it; none for step 0.
    pub from: Option<&'a [u8]>,
    /// Name of the checkpoint, and what it is of.
    pub part: &'a str,
    pub of: Digest,
    /// Begins the notes of its progress.
    pub note: &'a str,
    /// Photos that the curve is measured on; without any there is no curve.
    pub curve_photos: &'a [(NamedFrame<'a>, ScaledPhoto)],
    /// The time that it may take.
    pub clock: Option<Clock>,
    /// Tells what judging a photo takes, where judging is part of the same time.
    pub photo_s: Option<&'a JudgingTime<'a>>,
    /// The quality at which it stops.
    pub goal: Option<&'a Goal<'a>>,
}

impl<'a> Run<'a> {
    /// Returns the run of all steps of a training, without curve, clock and goal.
    pub fn once(steps: u64, (part, of): (&'a str, Digest)) -> Self {
        Self {
            schedule: Schedule::once(steps),
            until: None,
            from: None,
            part,
            of,
            note: "",
            curve_photos: &[],
            clock: None,
            photo_s: None,
            goal: None,
        }
    }
}

/// Counts beside the weights; part of a checkpoint, so that a resumed training reports the same.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct TrainingLog {
    pub curve: Curve,
    /// Steps after which it was last known whether something is due there.
    measured: u64,
    pub rays: u64,
    pub samples: u64,
    loss_sum: f64,
    loss_steps: u64,
    /// Of a training with a clock.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clocked: Option<Clocked>,
    /// Of a training with a goal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub watched: Option<Watched>,
    /// Steps that an unfinished run had taken before.
    #[serde(skip)]
    pub resumed_at: u64,
}

/// Trains from the last checkpoint, or the state that the run begins with, until the step after which it stops.
///
/// # Errors
/// A state of another training, or of a later step; a step that fails.
pub(crate) fn train_to(
    ctx: &Ctx<'_>,
    run: &Run<'_>,
    trainer: &mut Trainer,
) -> Result<TrainingLog, StageError> {
    trainer.follow(run.schedule.clone());
    let mut log = begin(ctx, run, trainer)?;
    let mut ticking = log.start(run.clock, trainer);
    let mut saved_at = Instant::now();
    let mut reported: Option<Instant> = None;
    loop {
        let looked = ctx.check().and_then(|()| look(ctx, run, trainer, &mut log));
        let until = run.until.unwrap_or(trainer.schedule().steps());
        log.note_clock(ticking.as_ref(), trainer);
        match looked {
            Err(stopped) => {
                log.settle(trainer)?;
                save(ctx, run, &log, trainer)?;
                return Err(stopped);
            }
            Ok(has_target) if has_target || trainer.steps() >= until => {
                log.settle(trainer)?;
                return Ok(log);
            }
            Ok(_) => {}
        }
        log.measured = trainer.steps();
        let step = trainer.advance(until - log.measured).map_err(TrainError::from)?;
        log.add(&step);
        if let Some(ticking) = &mut ticking {
            if let Some(photo_s) = run.photo_s.filter(|_| ticking.is_to_judge(trainer.steps())) {
                ticking.leave(photo_s(trainer)?);
            }
            ticking.plan(trainer);
        }
        if reported.is_none_or(|at| at.elapsed() >= REPORT_EVERY) {
            let note = format!("{}{}", run.note, log.note(run, &step));
            ctx.progress
                .at(trainer.steps(), until.max(trainer.steps()), &note);
            reported = Some(Instant::now());
        }
        if saved_at.elapsed() >= SAVE_EVERY {
            log.note_clock(ticking.as_ref(), trainer);
            log.settle(trainer)?;
            save(ctx, run, &log, trainer)?;
            saved_at = Instant::now();
        }
    }
}

/// Measures what is due after the steps taken last, and returns whether the field has the target.
fn look(
    ctx: &Ctx<'_>,
    run: &Run<'_>,
    trainer: &mut Trainer,
    log: &mut TrainingLog,
) -> Result<bool, StageError> {
    let taken = log.measured..trainer.steps();
    let schedule = trainer.schedule().clone();
    let is_point = !run.curve_photos.is_empty() && is_curve_point(&taken, &schedule);
    let goal = run.goal.filter(|goal| goal.is_due(&taken, schedule.steps()));
    if taken.is_empty() || !(is_point || goal.is_some()) {
        return Ok(false);
    }
    log.settle(trainer)?;
    let field = trainer.field().map_err(TrainError::from)?;
    let mut has_target = false;
    if let Some(goal) = goal {
        let place = (taken.end, schedule.done(taken.end), schedule.end_at(taken.end));
        let mut watched = log.watched.clone().unwrap_or_default();
        has_target = goal.look(ctx, &mut watched, &field, place)?;
        log.watched = Some(watched);
    }
    if is_point || has_target {
        log.point(taken.end, mean_psnr(ctx, &field, run.curve_photos)?);
    }
    log.measured = taken.end;
    Ok(has_target)
}

/// Reads all held-out photos, so that one that cannot be read stops a training before it begins, and returns up to
/// three, evenly spaced and thinned, to measure the curve on.
pub(crate) fn curve_photos<'a>(
    photos: &PhotoReader<'_>,
    held_out: &[NamedFrame<'a>],
    at_once: usize,
) -> Result<Vec<(NamedFrame<'a>, ScaledPhoto)>, StageError> {
    let count = held_out.len().min(CURVE_PHOTOS);
    let places: Vec<usize> = (0..count).map(|photo| photo * held_out.len() / count).collect();
    let thinned =
        |index: usize, photo: ScaledPhoto| places.contains(&index).then(|| photo.thinned_to(CURVE_SIDE_PX));
    let read = photos.map(held_out, at_once, thinned)?;
    let pairs = held_out.iter().zip(read);
    Ok(pairs
        .filter_map(|(named, photo)| Some((named.clone(), photo?)))
        .collect())
}

/// Tells whether a point of the curve falls among the steps taken: at 1/16 of all steps and at every eighth.
fn is_curve_point(taken: &Range<u64>, schedule: &Schedule) -> bool {
    let (before, after) = (schedule.done(taken.start), schedule.done(taken.end));
    let crosses = |parts: f64| (after * parts).floor() > (before * parts).floor();
    crosses(8.0) || (crosses(16.0) && before < 1.0 / 8.0)
}

impl TrainingLog {
    fn add(&mut self, step: &marf_field::Step) {
        self.rays += step.rays;
        self.samples += step.samples;
        self.loss_sum += step.loss * step.steps as f64;
        self.loss_steps += step.steps;
    }

    /// Adds what the trainer has not told of, so that the log is of all steps taken.
    fn settle(&mut self, trainer: &mut Trainer) -> Result<(), TrainError> {
        self.add(&trainer.settle()?);
        Ok(())
    }

    /// Returns about how long the steps took that an unfinished run had taken, seconds: as long each as those since, which took `own_s`.
    /// 0 where none is its own.
    pub fn before_stop_s(&self, steps: u64, own_s: f64) -> f64 {
        match steps.saturating_sub(self.resumed_at) {
            0 => 0.0,
            own => own_s * self.resumed_at as f64 / own as f64,
        }
    }

    fn point(&mut self, step: u64, psnr: f64) {
        self.curve.0.push(CurvePoint {
            step,
            rays: self.rays,
            samples: self.samples,
            loss: self.loss_sum / self.loss_steps.max(1) as f64,
            psnr,
        });
        (self.loss_sum, self.loss_steps) = (0.0, 0);
    }

    fn note(&self, run: &Run<'_>, step: &marf_field::Step) -> String {
        let goal = run.goal.zip(self.watched.as_ref());
        let goal = goal.map_or_else(String::new, |(goal, watched)| watched.note(goal.psnr));
        // What came of the first steps on a GPU is not known at once.
        let loss = match step.steps {
            0 => "first steps".to_owned(),
            _ => format!("loss {:.4}", step.loss),
        };
        match self.curve.0.last() {
            Some(point) => format!("{goal}{loss} psnr {:.1}", point.psnr),
            None => format!("{goal}{loss}"),
        }
    }

    /// Starts the clock of a training where this log has it.
    fn start(&self, clock: Option<Clock>, trainer: &mut Trainer) -> Option<Ticking> {
        let mut clock = clock?;
        if let Some(clocked) = &self.clocked {
            clock.resume(clocked);
            trainer.follow(clocked.schedule.clone());
        }
        Some(clock.start(trainer.steps()))
    }

    fn note_clock(&mut self, ticking: Option<&Ticking>, trainer: &Trainer) {
        self.clocked = ticking.map(|ticking| ticking.clocked(trainer.schedule()));
    }
}

/// Puts the trainer where the last checkpoint was, or else at the state that the run begins with, and returns the log of that
/// moment.
fn begin(ctx: &Ctx<'_>, run: &Run<'_>, trainer: &mut Trainer) -> Result<TrainingLog, TrainError> {
    let saved = checkpoint::load(ctx, run.part, &run.of);
    if let Some((log, state)) = saved.as_deref().and_then(unpack::<TrainingLog>)
        && trainer.restore(state).is_ok()
    {
        return Ok(TrainingLog {
            resumed_at: trainer.steps(),
            ..log
        });
    }
    let Some(from) = run.from else {
        return Ok(TrainingLog::default());
    };
    let unreadable = || TrainError::State("it is cut, or no state of a training".to_owned());
    let (log, state) = unpack::<TrainingLog>(from).ok_or_else(unreadable)?;
    let restored = trainer.restore(state);
    restored.map_err(|error| TrainError::State(error.to_string()))?;
    let until = run.until.unwrap_or(run.schedule.steps());
    match trainer.steps() {
        at if at > until => Err(TrainError::Behind { at, until }),
        _ => Ok(log),
    }
}

/// Saves a checkpoint; the log is settled.
pub(crate) fn save(
    ctx: &Ctx<'_>,
    run: &Run<'_>,
    log: &TrainingLog,
    trainer: &mut Trainer,
) -> Result<(), TrainError> {
    checkpoint::save(ctx, run.part, &run.of, &packed_state(log, trainer)?);
    Ok(())
}

/// Returns the whole state of a training: its counts and that of its trainer.
///
/// # Errors
/// A GPU that failed.
pub(crate) fn packed_state(log: &TrainingLog, trainer: &mut Trainer) -> Result<Vec<u8>, TrainError> {
    Ok(pack(log, &trainer.save()?))
}

/// Length of the facts as u64 LE, the facts as JSON, the bytes.
pub(crate) fn pack<T: Serialize>(facts: &T, bytes: &[u8]) -> Vec<u8> {
    // Numbers, texts and lists always serialise.
    let facts = serde_json::to_vec(facts).unwrap_or_default();
    let length = (facts.len() as u64).to_le_bytes();
    [length.as_slice(), &facts, bytes].concat()
}

/// Reads what [`pack`] wrote; none if it is anything else.
pub(crate) fn unpack<T: DeserializeOwned>(state: &[u8]) -> Option<(T, &[u8])> {
    let (length, rest) = state.split_first_chunk::<8>()?;
    let (facts, bytes) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    Some((serde_json::from_slice(facts).ok()?, bytes))
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

    #[test]
    fn steps_before_a_stop_count_as_long_as_those_since() {
        let log = |resumed_at: u64| TrainingLog {
            resumed_at,
            ..TrainingLog::default()
        };
        assert_eq!(log(300).before_stop_s(400, 10.0), 30.0);
        assert_eq!(log(0).before_stop_s(400, 10.0), 0.0);
        assert_eq!(log(400).before_stop_s(400, 0.1), 0.0);
    }

    #[test]
    fn a_checkpoint_survives_and_a_cut_one_is_no_checkpoint() {
        let mut log = TrainingLog::default();
        log.add(&marf_field::Step {
            steps: 1,
            loss: 0.1,
            rays: 3,
            samples: 7,
        });
        log.point(1, 12.345_678_901_234_567);
        log.add(&marf_field::Step {
            steps: 1,
            loss: 1.0 / 3.0,
            rays: 3,
            samples: 7,
        });
        let packed = pack(&log, b"weights");
        assert_eq!(unpack(&packed), Some((log, b"weights".as_slice())));
        for damaged in [&packed[..20], &[255; 8], &[]] {
            assert_eq!(unpack::<TrainingLog>(damaged), None, "{} bytes", damaged.len());
        }
    }
}

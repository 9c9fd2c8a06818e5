use std::ops::Range;
use std::time::{Duration, Instant};

use marf_field::{Field, Trainer};
use marf_schema::train::{Curve, CurvePoint};
use marf_stage::{Ctx, StageError};
use serde::{Deserialize, Serialize};

use crate::{
    TrainError,
    judge::mean_psnr,
    split::{Named, Reduced, reduced},
};

/// Wall clock between two checkpoints: what a killed run loses at most.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(10);
/// Wall clock between two reports of progress.
const REPORT_EVERY: Duration = Duration::from_millis(200);
/// Photos that the curve is measured on, and their longest side in pixels: nine points cost a tenth of a draft.
const PROBES: usize = 3;
const PROBE_SIDE_PX: u32 = 64;

/// A training that has come to its end.
pub(crate) struct Fitted {
    pub field: Field,
    pub log: Log,
}

/// What is counted beside the weights; part of a checkpoint, so that a resumed run tells the same.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Log {
    /// Steps this training goes to: `budget` may mean others on another machine, and the curve's places follow.
    steps: u64,
    pub curve: Curve,
    pub rays: u64,
    pub samples: u64,
    loss_sum: f64,
    loss_steps: u64,
}

/// Trains to `steps`, measuring the curve on `probes`, from the last checkpoint if there is one.
pub(crate) fn fit(
    ctx: &Ctx<'_>,
    mut trainer: Trainer,
    steps: u64,
    probes: &[(Named<'_>, Reduced)],
) -> Result<Fitted, StageError> {
    let mut log = resume(ctx, &mut trainer, steps);
    let mut kept = Instant::now();
    let mut reported: Option<Instant> = None;
    while trainer.steps() < steps {
        if let Err(stopped) = ctx.check() {
            ctx.checkpoints.save(&pack(&log, &saved(&mut trainer)?));
            return Err(stopped);
        }
        let before = trainer.steps();
        let step = trainer.advance(steps - before).map_err(TrainError::from)?;
        log.add(&step);
        if is_curve_point(before..trainer.steps(), steps) {
            let field = trainer.field().map_err(TrainError::from)?;
            let psnr = mean_psnr(ctx, &field, probes)?;
            log.point(trainer.steps(), psnr);
        }
        if reported.is_none_or(|at| at.elapsed() >= REPORT_EVERY) {
            ctx.progress.at(trainer.steps(), steps, &log.note(step.loss));
            reported = Some(Instant::now());
        }
        if kept.elapsed() >= CHECKPOINT_EVERY {
            ctx.checkpoints.save(&pack(&log, &saved(&mut trainer)?));
            kept = Instant::now();
        }
    }
    let field = trainer.field().map_err(TrainError::from)?;
    Ok(Fitted { field, log })
}

/// Reads evenly spaced held-out photos and shrinks them further.
pub(crate) fn probes<'a>(
    ctx: &Ctx<'_>,
    held_out: &[Named<'a>],
    scale: u32,
) -> Result<Vec<(Named<'a>, Reduced)>, StageError> {
    let count = held_out.len().min(PROBES);
    let places = (0..count).map(|probe| probe * held_out.len() / count);
    places
        .map(|place| {
            let named = &held_out[place];
            let photo = reduced(ctx, named.frame, scale)?;
            Ok((named.clone(), shrunk(&photo, PROBE_SIDE_PX)))
        })
        .collect()
}

/// Shrinks a photo until its longest side is at most `side_px`, if its shortest bears it.
pub(crate) fn shrunk(photo: &Reduced, side_px: u32) -> Reduced {
    let longest = photo.camera.width.max(photo.camera.height);
    let shortest = photo.camera.width.min(photo.camera.height);
    let factor = longest.div_ceil(side_px).clamp(1, shortest);
    Reduced {
        camera: photo.camera.box_reduced(factor),
        image: photo.image.box_reduced(factor),
    }
}

fn saved(trainer: &mut Trainer) -> Result<Vec<u8>, TrainError> {
    Ok(trainer.save()?)
}

/// At 1/16 of the steps and at every eighth, or as soon after as a trainer that takes several at once tells.
fn is_curve_point(taken: Range<u64>, steps: u64) -> bool {
    let crosses = |parts: u64| {
        let part = |step: u64| u128::from(step) * u128::from(parts) / u128::from(steps);
        part(taken.end) > part(taken.start)
    };
    crosses(8) || (crosses(16) && taken.start < steps / 8)
}

impl Log {
    fn add(&mut self, step: &marf_field::Step) {
        self.rays += step.rays;
        self.samples += step.samples;
        self.loss_sum += step.loss * step.steps as f64;
        self.loss_steps += step.steps;
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

    fn note(&self, loss: f64) -> String {
        match self.curve.0.last() {
            Some(point) => format!("loss {loss:.4} psnr {:.1}", point.psnr),
            None => format!("loss {loss:.4}"),
        }
    }
}

/// A checkpoint of another length, or one that cannot be read, costs only time: training then starts over.
fn resume(ctx: &Ctx<'_>, trainer: &mut Trainer, steps: u64) -> Log {
    let fresh = Log {
        steps,
        ..Log::default()
    };
    let Some(state) = ctx.checkpoints.load() else {
        return fresh;
    };
    let fits = |(log, weights): &(Log, &[u8])| log.steps == steps && trainer.restore(weights).is_ok();
    unpack(&state).filter(fits).map_or(fresh, |(log, _)| log)
}

/// Length of the log as u64 LE, the log as JSON, the trainer's own state.
fn pack(log: &Log, trainer: &[u8]) -> Vec<u8> {
    // Numbers and lists always serialise.
    let log = serde_json::to_vec(log).unwrap_or_default();
    let length = (log.len() as u64).to_le_bytes();
    [length.as_slice(), &log, trainer].concat()
}

fn unpack(state: &[u8]) -> Option<(Log, &[u8])> {
    let (length, rest) = state.split_first_chunk::<8>()?;
    let (log, trainer) = rest.split_at_checked(u64::from_le_bytes(*length) as usize)?;
    Some((serde_json::from_slice(log).ok()?, trainer))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_has_nine_points_at_fixed_shares_of_the_steps() {
        for steps in [16_u64, 100, 401, 20_000] {
            let points: Vec<u64> = (1..=steps)
                .filter(|step| is_curve_point(*step - 1..*step, steps))
                .collect();
            assert_eq!(points.len(), 9, "{steps}: {points:?}");
            assert_eq!((points[0], points[8]), (steps.div_ceil(16), steps));
        }
        for steps in 1..16 {
            let points: Vec<u64> = (1..=steps)
                .filter(|step| is_curve_point(*step - 1..*step, steps))
                .collect();
            assert_eq!(points.last(), Some(&steps), "{points:?}");
        }
    }

    #[test]
    fn a_checkpoint_survives_and_a_cut_one_is_no_checkpoint() {
        let mut log = Log::default();
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
        assert_eq!(unpack(&packed[..20]), None);
        assert_eq!(unpack(&[255; 8]), None);
        assert_eq!(unpack(&[]), None);
    }
}

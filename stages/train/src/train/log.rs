//! The counts of a training, and how they are stored with its state.

use marf_field::{Step, Trainer};
use marf_schema::train::{Curve, CurvePoint};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::planner::PlannerState;
use crate::TrainError;

/// Counts kept with the weights. Part of a checkpoint, so that a resumed training reports the same.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct TrainingLog {
    pub curve: Curve,
    /// Steps after which it was last known whether something is due there.
    pub measured: u64,
    pub rays: u64,
    pub samples: u64,
    loss_sum: f64,
    loss_steps: u64,
    /// Of a training with a time or a target.
    #[serde(default, skip_serializing_if = "PlannerState::is_empty")]
    pub planner: PlannerState,
    /// Steps that an unfinished run had taken before.
    #[serde(skip)]
    pub resumed_at: u64,
}

impl TrainingLog {
    /// Adds what a step has trained.
    pub fn add(&mut self, step: &Step) {
        self.rays += step.rays;
        self.samples += step.samples;
        self.loss_sum += step.loss * step.steps as f64;
        self.loss_steps += step.steps;
    }

    /// Adds the steps that the trainer has not reported yet, so that the log is of all steps taken.
    pub fn settle(&mut self, trainer: &mut Trainer) -> Result<(), TrainError> {
        self.add(&trainer.settle()?);
        Ok(())
    }

    /// Estimates how long the steps of the unfinished run took, seconds: as long each as those since, which took `own_s`. 0 before the
    /// first own step.
    pub fn before_stop_s(&self, steps: u64, own_s: f64) -> f64 {
        match steps.saturating_sub(self.resumed_at) {
            0 => 0.0,
            own => own_s * self.resumed_at as f64 / own as f64,
        }
    }

    /// Adds a point of the curve.
    pub fn point(&mut self, step: u64, psnr: f64) {
        self.curve.0.push(CurvePoint {
            step,
            rays: self.rays,
            samples: self.samples,
            loss: self.loss_sum / self.loss_steps.max(1) as f64,
            psnr,
        });
        (self.loss_sum, self.loss_steps) = (0.0, 0);
    }

    /// Returns the note of the progress after a step, which begins with `target`.
    pub fn note(&self, target: &str, step: &Step) -> String {
        // What came of the first steps on a GPU is not known at once.
        let loss = match step.steps {
            0 => "first steps".to_owned(),
            _ => format!("loss {:.4}", step.loss),
        };
        match self.curve.0.last() {
            Some(point) => format!("{target}{loss} psnr {:.1}", point.psnr),
            None => format!("{target}{loss}"),
        }
    }
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

/// Reads the bytes of [`pack`]. `None` if they are anything else.
pub(crate) fn unpack<T: DeserializeOwned>(state: &[u8]) -> Option<(T, &[u8])> {
    let (length, rest) = state.split_first_chunk::<8>()?;
    let (facts, bytes) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    Some((serde_json::from_slice(facts).ok()?, bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

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
        log.add(&Step {
            steps: 1,
            loss: 0.1,
            rays: 3,
            samples: 7,
        });
        log.point(1, 12.345_678_901_234_567);
        log.add(&Step {
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

//! A stopped adjustment is resumed, and a finished one is not repeated.

use marf_scene::{Camera, Pose};
use nalgebra::Vector3;

use super::options::{BundleOptions, BundleReport};
use super::problem::Problem;
use super::state::State;
use super::step_control::StepControl;
use crate::Supervisor;
use crate::bytes::{decode, encode, fingerprint};
use crate::supervisor::{SAVE_FINISHED, SAVE_UNFINISHED};

/// Forms of both states. A new number for any change of how one is written or used.
const FINISHED: &[u8; 8] = b"adjend02";
const UNFINISHED: &[u8; 8] = b"adjrun02";

/// The checkpoint of one adjustment, by the fingerprint of its problem.
pub(super) struct Checkpoint<'a> {
    pub supervisor: &'a dyn Supervisor,
    part: String,
    fingerprint: u64,
    /// What an earlier run has saved.
    saved: Option<Vec<u8>>,
}

/// Cameras, poses, points and report.
type SavedResult = (Vec<Camera>, Vec<Pose>, Vec<Vector3<f64>>, BundleReport);

impl<'a> Checkpoint<'a> {
    pub fn new(supervisor: &'a dyn Supervisor, problem: &Problem, options: &BundleOptions) -> Self {
        let fingerprint = fingerprint(&(problem, options));
        let part = format!("adjustment-{fingerprint:016x}");
        Self {
            saved: supervisor.load(&part),
            supervisor,
            part,
            fingerprint,
        }
    }

    /// Sets the problem to its result if an earlier run has found it, and returns the report.
    pub fn finished(&self, problem: &mut Problem) -> Option<BundleReport> {
        let found: SavedResult = decode(self.saved.as_ref()?, FINISHED, self.fingerprint)?;
        let report;
        (problem.cameras, problem.poses, problem.points, report) = found;
        Some(report)
    }

    /// Saves the result, unless it took so little time that it is found again as fast.
    pub fn save_finished(&self, problem: &Problem, report: &BundleReport) {
        if self.supervisor.unsaved_for() >= SAVE_FINISHED {
            let state = (&problem.cameras, &problem.poses, &problem.points, report);
            let state = encode(FINISHED, self.fingerprint, &state);
            self.supervisor.save(&self.part, &state);
        }
    }

    /// Returns the saved inputs of the step from which to resume an earlier run.
    pub fn unfinished(&self) -> Option<(State, StepControl, BundleReport)> {
        decode(self.saved.as_ref()?, UNFINISHED, self.fingerprint)
    }

    /// Saves the state before a step, now and then.
    pub fn save_unfinished(&self, state: &State, control: &StepControl, report: &BundleReport) {
        if report.iterations > 0 && self.supervisor.unsaved_for() >= SAVE_UNFINISHED {
            let state = encode(UNFINISHED, self.fingerprint, &(state, control, report));
            self.supervisor.save(&self.part, &state);
        }
    }
}

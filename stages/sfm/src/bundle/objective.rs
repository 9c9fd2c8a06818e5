//! The objective of an adjustment: the problem, its index, and the cost.

#[cfg(test)]
use nalgebra::Vector2;
use rayon::prelude::*;

use super::index::Index;
use super::loss::Loss;
use super::priors;
use super::problem::{Observation, Prior, Problem};
use super::residual::project;
use super::state::{CameraBounds, Normalization, State};

/// Observations whose costs are summed at once. The chunks do not depend on the number of threads.
const CHUNK: usize = 4096;

/// Larger residuals count as not projected, so that squares stay finite.
const FAR_PX: f64 = 1e9;

/// What stays constant while the parameters vary.
pub(super) struct Objective<'a> {
    pub problem: &'a Problem,
    pub index: Index,
    /// In normalised coordinates.
    pub priors: Vec<Prior>,
    pub camera_bounds: Vec<CameraBounds>,
    pub loss: Loss,
    pub prior_loss: Loss,
    /// Loss of an observation without a projection, by camera: that of an error of the photo's diagonal.
    hidden: Vec<f64>,
}

impl<'a> Objective<'a> {
    pub(super) fn new(
        problem: &'a Problem,
        normalization: &Normalization,
        loss: Loss,
        prior_loss: Loss,
    ) -> Self {
        let squared_diagonal = |camera: &marf_scene::Camera| {
            f64::from(camera.width) * f64::from(camera.width)
                + f64::from(camera.height) * f64::from(camera.height)
        };
        Self {
            problem,
            index: Index::new(problem),
            priors: problem
                .priors
                .iter()
                .map(|prior| normalization.prior(prior))
                .collect(),
            camera_bounds: problem.cameras.iter().map(CameraBounds::new).collect(),
            loss,
            prior_loss,
            hidden: problem
                .cameras
                .iter()
                .map(|camera| loss.cost(squared_diagonal(camera)))
                .collect(),
        }
    }

    /// Returns the index of the camera of an observation.
    pub(super) fn camera_of(&self, observation: &Observation) -> usize {
        self.problem.camera_of_pose[observation.pose as usize] as usize
    }

    /// Returns the number of residual scalars: two for each observation, projected or not, and those of the priors.
    pub(super) fn residuals(&self) -> usize {
        let priors: usize = self.priors.iter().map(priors::count).sum();
        2 * self.problem.observations.len() + priors
    }

    /// Returns the cost ½ Σ ρ.
    pub(super) fn cost(&self, state: &State) -> f64 {
        let chunks = self.problem.observations.par_chunks(CHUNK);
        let sums: Vec<f64> = chunks.map(|chunk| self.cost_of(chunk, state)).collect();
        let priors: f64 = self
            .priors
            .iter()
            .map(|prior| self.prior_loss.cost(priors::error(prior, state).norm_squared()))
            .sum();
        0.5 * (sums.iter().sum::<f64>() + priors)
    }

    /// Returns the number of observations without a projection.
    pub(super) fn hidden(&self, state: &State) -> usize {
        let hidden = |observation: &&Observation| squared_error(self, observation, state).is_none();
        self.problem.observations.iter().filter(hidden).count()
    }

    /// Returns Σ ρ of a chunk of observations.
    fn cost_of(&self, chunk: &[Observation], state: &State) -> f64 {
        let cost = |observation: &Observation| match squared_error(self, observation, state) {
            Some(squared) => self.loss.cost(squared),
            None => self.hidden[self.camera_of(observation)],
        };
        chunk.iter().map(cost).sum()
    }
}

/// Returns the squared reprojection error. `None` without a projection.
fn squared_error(objective: &Objective, observation: &Observation, state: &State) -> Option<f64> {
    let camera = &state.cameras[objective.camera_of(observation)];
    let view = &state.views[observation.pose as usize];
    let projection = project(view, camera, &state.points[observation.point as usize])?;
    squared_length(projection.error(camera, &observation.pixel))
}

/// Returns the squared length of a residual, or `None` if it is too long.
#[inline]
pub(super) fn squared_length(error: [f64; 2]) -> Option<f64> {
    let squared = error[0] * error[0] + error[1] * error[1];
    (squared < FAR_PX * FAR_PX).then_some(squared)
}

/// Returns projected minus observed, pixels. `None` behind the camera or beyond the fold of the distortion.
#[cfg(test)]
pub(super) fn residual(problem: &Problem, observation: &Observation) -> Option<Vector2<f64>> {
    let pose = problem.poses.get(observation.pose as usize)?;
    let camera = *problem.camera_of_pose.get(observation.pose as usize)?;
    let point = problem.points.get(observation.point as usize)?;
    let projected = problem
        .cameras
        .get(camera as usize)?
        .project(&pose.point(point))?;
    let error = projected - observation.pixel;
    (error.x.is_finite() && error.y.is_finite()).then_some(error)
}

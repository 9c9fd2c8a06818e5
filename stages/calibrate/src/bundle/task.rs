//! What one adjustment works on, and the cost it lowers.

#[cfg(test)]
use nalgebra::Vector2;
use rayon::prelude::*;

use super::index::Index;
use super::sight::sight;
use super::state::{Bounds, Frame, State};
use super::{Loss, Observation, Prior, Problem, priors};

/// Observations whose costs are added up in one go; the chunks do not depend on the number of threads.
const CHUNK: usize = 4096;

/// Residuals beyond this count as not seen, so that squares stay finite.
const FAR_PX: f64 = 1e9;

/// Everything that does not change while the numbers move.
pub(super) struct Task<'a> {
    pub problem: &'a Problem,
    pub index: Index,
    /// In the coordinates of the inside.
    pub priors: Vec<Prior>,
    pub bounds: Vec<Bounds>,
    pub loss: Loss,
    pub prior_loss: Loss,
    /// Loss of an observation without a projection, by camera: that of the photo's diagonal.
    hidden: Vec<f64>,
}

impl<'a> Task<'a> {
    pub(super) fn new(problem: &'a Problem, frame: &Frame, loss: Loss, prior_loss: Loss) -> Self {
        let squared_diagonal = |camera: &marf_scene::Camera| {
            f64::from(camera.width) * f64::from(camera.width)
                + f64::from(camera.height) * f64::from(camera.height)
        };
        Self {
            problem,
            index: Index::new(problem),
            priors: problem.priors.iter().map(|prior| frame.prior(prior)).collect(),
            bounds: problem.cameras.iter().map(Bounds::of).collect(),
            loss,
            prior_loss,
            hidden: problem
                .cameras
                .iter()
                .map(|camera| loss.cost(squared_diagonal(camera)))
                .collect(),
        }
    }

    pub(super) fn camera_of(&self, seen: &Observation) -> usize {
        self.problem.camera_of_pose[seen.pose as usize] as usize
    }

    /// Residual scalars: two an observation, seen or not, and those of the priors.
    pub(super) fn residuals(&self) -> usize {
        let priors: usize = self.priors.iter().map(priors::count).sum();
        2 * self.problem.observations.len() + priors
    }

    /// Returns ½ Σ ρ.
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

    /// Number of observations without a projection.
    pub(super) fn hidden(&self, state: &State) -> usize {
        let hidden = |seen: &&Observation| squared_error(self, seen, state).is_none();
        self.problem.observations.iter().filter(hidden).count()
    }

    fn cost_of(&self, chunk: &[Observation], state: &State) -> f64 {
        let cost = |seen: &Observation| match squared_error(self, seen, state) {
            Some(squared) => self.loss.cost(squared),
            None => self.hidden[self.camera_of(seen)],
        };
        chunk.iter().map(cost).sum()
    }
}

fn squared_error(task: &Task, seen: &Observation, state: &State) -> Option<f64> {
    let camera = &state.cameras[task.camera_of(seen)];
    let view = &state.views[seen.pose as usize];
    let sight = sight(view, camera, &state.points[seen.point as usize])?;
    near(sight.error(camera, &seen.pixel))
}

/// Returns the squared length of a residual, or `None` where it is too long to count.
#[inline]
pub(super) fn near(error: [f64; 2]) -> Option<f64> {
    let squared = error[0] * error[0] + error[1] * error[1];
    (squared < FAR_PX * FAR_PX).then_some(squared)
}

/// Returns projected minus observed, pixels; `None` behind the camera or beyond the lens's fold.
#[cfg(test)]
pub(crate) fn residual(problem: &Problem, observation: &Observation) -> Option<Vector2<f64>> {
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

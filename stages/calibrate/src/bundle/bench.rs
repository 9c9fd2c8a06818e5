//! What the benches run: noisy walks of the size of real ones.

use super::synthetic::{Walk, add_noise, disturb, walk};
use super::{BundleOptions, Loss, PoseFreedom, Problem, Solver, adjust};
use crate::dice::Dice;

/// A problem ready to be adjusted.
#[doc(hidden)]
#[derive(Debug, Clone)]
pub struct Adjustment {
    problem: Problem,
    solver: Solver,
}

/// Makes a walk of which the first `free` poses may move, solved densely or (`dense` 0) by conjugate gradients.
#[doc(hidden)]
pub fn adjustment(poses: usize, points: usize, free: usize, dense: usize) -> Adjustment {
    let size = Walk {
        poses,
        points,
        longest_track: 17,
        seed: 1,
    };
    let mut problem = walk(&size);
    let mut dice = Dice::new(2);
    problem.pose_freedom[free..].fill(PoseFreedom::Fixed);
    add_noise(&mut problem, 0.5, &mut dice);
    disturb(&mut problem, 0.003, 0.01, &mut dice);
    problem.cameras[0].fx_px *= 1.02;
    problem.cameras[0].fy_px *= 1.02;
    let solver = match dense {
        0 => Solver::ConjugateGradients,
        _ => Solver::Dense,
    };
    Adjustment { problem, solver }
}

impl Adjustment {
    /// Number of observations.
    pub fn observations(&self) -> usize {
        self.problem.observations.len()
    }

    /// Runs 15 steps; returns how many, and the cost.
    pub fn run(&self) -> (u32, f64) {
        let options = BundleOptions {
            loss: Loss::Cauchy(1.0),
            prior_loss: Loss::Squared,
            max_iterations: 15,
            tolerance: 0.0,
            solver: self.solver,
        };
        match adjust(&mut self.problem.clone(), &options, &|| false) {
            Ok(report) => (report.iterations, report.final_cost),
            Err(_) => (0, f64::MAX),
        }
    }
}

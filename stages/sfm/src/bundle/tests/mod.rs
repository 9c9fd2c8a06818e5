//! Tests of the whole adjustment on scenes of known truth.

mod covariance;
mod extremes;
mod jacobians;
mod noise;
mod priors;
mod stopped;

use marf_numeric::Rng;
use marf_scene::Pose;

use super::objective::residual;
use super::synthetic::{RingSize, perturb, ring};
use super::*;

const EXACT: BundleOptions = BundleOptions {
    loss: Loss::Squared,
    prior_loss: Loss::Squared,
    max_iterations: 60,
    tolerance: 1e-14,
    solver: Solver::Auto,
};

const SMALL: RingSize = RingSize {
    poses: 12,
    points: 150,
    longest_track: 7,
    seed: 5,
};

fn run(problem: &mut Problem, options: &BundleOptions) -> BundleReport {
    adjust(problem, options, &|| false).unwrap()
}

/// Largest difference of rotations (radian) and of centres.
fn distance(found: &[Pose], truth: &[Pose]) -> (f64, f64) {
    let mut worst = (0.0_f64, 0.0_f64);
    for (found, truth) in found.iter().zip(truth) {
        let angle = so3::log(&(found.rotation * truth.rotation.transpose())).norm();
        worst.0 = worst.0.max(angle);
        worst.1 = worst.1.max((found.centre() - truth.centre()).norm());
    }
    worst
}

/// Turns all poses, moves centres and points a little.
fn perturbed(exact: &Problem, angle_rad: f64, distance: f64) -> Problem {
    let mut problem = exact.clone();
    perturb(&mut problem, angle_rad, distance, &mut Rng::new(11));
    problem
}

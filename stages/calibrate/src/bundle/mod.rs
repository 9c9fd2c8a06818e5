//! Bundle adjustment: poses, points and lenses that explain all observations best, in f64.
//!
//! `index` says who sees what, `state` what moves, `sight` how one observation changes; `system` sums the normal
//! equations, `schur` takes the points out, `dense` or `gradients` solve the rest, `solve` steps downhill.

pub(crate) mod bench;
mod check;
mod cholesky;
mod covariance;
mod dense;
mod gradients;
mod index;
mod loss;
mod priors;
mod problem;
mod schur;
mod sight;
mod solve;
mod state;
pub(crate) mod synthetic;
mod system;
mod task;
#[cfg(test)]
mod tests;
mod turn;

pub(crate) use check::BundleError;
pub(crate) use covariance::pose_covariances;
pub(crate) use loss::Loss;
pub(crate) use problem::{CameraFreedom, LensModel, Observation, PoseFreedom, Prior, Problem};
pub(crate) use solve::adjust;
#[cfg(test)]
pub(crate) use task::residual;

/// How the reduced system of poses and lenses is solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Solver {
    /// Dense up to 600 poses that move.
    Auto,
    /// Cholesky factorisation; 8 n² bytes for n unknowns.
    Dense,
    /// As exact as the last step needs.
    ConjugateGradients,
}

/// How a problem is adjusted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BundleOptions {
    /// Of observations, pixels.
    pub loss: Loss,
    /// Of priors, sigmas; a prior is one residual, of up to six numbers.
    pub prior_loss: Loss,
    pub max_iterations: u32,
    /// Relative change of the cost at which to stop.
    pub tolerance: f64,
    pub solver: Solver,
}

/// What an adjustment came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BundleReport {
    /// Steps tried.
    pub iterations: u32,
    /// ½ Σ ρ before.
    pub initial_cost: f64,
    /// ½ Σ ρ after.
    pub final_cost: f64,
    /// Residual scalars: two an observation, seen or not, and those of the priors.
    pub residuals: usize,
    /// Numbers that may move.
    pub parameters: usize,
    /// Observations without a projection at the end (behind the camera, beyond the fold).
    pub hidden: usize,
    /// Whether the tolerance was reached.
    pub converged: bool,
}

/// Returns n ln(Σρ / n) + k ln n, for n residuals and k numbers that may move: of two lens models fitted to the same
/// observations with the same loss, that with the smaller value is the better supported.
///
/// Schwarz's criterion with the noise's scale unknown; Σρ takes the place of the sum of squares (Machado 1993,
/// "Robust model selection and M-estimation"): exp(-½ Σρ / s²) is the likelihood that the robust fit maximises, s² =
/// Σρ / n maximises it over the scale, and the penalty depends on how k grows, not on the tail. With the plain sum of
/// squares a lens could win or lose by a few mismatches. Finite also for an exact fit.
pub(crate) fn information_criterion(report: &BundleReport) -> f64 {
    let n = report.residuals.max(1) as f64;
    let mean = (2.0 * report.final_cost / n).max(f64::MIN_POSITIVE);
    n * libm::log(mean) + report.parameters as f64 * libm::log(n)
}

//! Options and report of an adjustment, and the criterion by which models are compared.

use super::loss::Loss;

/// How the reduced system of poses and cameras is solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Solver {
    /// Dense up to 600 free poses, conjugate gradients above.
    Auto,
    /// Cholesky factorisation, in 8 n² bytes for n unknowns.
    Dense,
    /// Conjugate gradients, as exact as the last step needs.
    ConjugateGradients,
}

/// Options of a bundle adjustment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BundleOptions {
    /// Loss of observations, in pixels.
    pub loss: Loss,
    /// Loss of priors, in sigmas. A prior is one residual of up to six numbers.
    pub prior_loss: Loss,
    /// Largest number of steps tried.
    pub max_iterations: u32,
    /// Relative change of the cost at which the adjustment ends.
    pub tolerance: f64,
    /// How the reduced system is solved.
    pub solver: Solver,
}

/// Result of a bundle adjustment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BundleReport {
    /// Steps tried.
    pub iterations: u32,
    /// ½ Σ ρ before.
    pub initial_cost: f64,
    /// ½ Σ ρ after.
    pub final_cost: f64,
    /// Number of residual scalars: two for each observation, projected or not, and those of the priors.
    pub residuals: usize,
    /// Number of free parameters.
    pub parameters: usize,
    /// Observations without a projection at the end (behind the camera or beyond the fold of the distortion).
    pub hidden: usize,
    /// Whether the tolerance was reached.
    pub converged: bool,
}

/// Returns the Bayesian information criterion n ln(Σρ / n) + k ln n, for n residuals and k free parameters. Of two
/// lens models fitted to the same observations with the same loss, the one with the smaller value is better
/// supported.
///
/// Schwarz's criterion with unknown noise and Σρ instead of the sum of squares (Machado 1993, "Robust model selection
/// and M-estimation"). The robust fit maximises the likelihood exp(-½ Σρ / s²), and s² = Σρ / n maximises it over the
/// scale. The penalty depends on how k grows, not on the tail. With the plain sum of squares a lens could win or lose
/// by a few mismatches. Finite also for an exact fit.
pub fn information_criterion(report: &BundleReport) -> f64 {
    let n = report.residuals.max(1) as f64;
    let mean = (2.0 * report.final_cost / n).max(f64::MIN_POSITIVE);
    n * libm::log(mean) + report.parameters as f64 * libm::log(n)
}

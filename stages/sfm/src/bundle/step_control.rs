//! How the next step of an adjustment is computed: solver, damping, accuracy.

use super::options::{BundleOptions, Solver};

/// Damping of the first step, as a share of the diagonal.
const FIRST_DAMPING: f64 = 1e-4;

/// Free poses up to which the matrix is factored. A ring of 300 photos took 5 CPU s dense and 34 by conjugate
/// gradients (15 steps, long chains converge slowly). At 600 a factorisation is 16 GFLOP and the matrix 104 MB.
const MOST_DENSE_POSES: usize = 600;

/// How the next step is computed.
#[derive(Debug, Clone, Copy)]
pub(super) struct StepControl {
    pub solver: Solver,
    pub damping: f64,
    /// Factor by which the damping rises next.
    pub rise: f64,
    /// Relative residual at which conjugate gradients end.
    pub forcing: f64,
}

impl StepControl {
    /// Returns the control of the first step, for a number of free poses.
    pub(super) fn new(poses: usize, options: &BundleOptions) -> Self {
        let solver = match options.solver {
            Solver::Auto if poses > MOST_DENSE_POSES => Solver::ConjugateGradients,
            Solver::Auto => Solver::Dense,
            chosen => chosen,
        };
        Self {
            solver,
            damping: FIRST_DAMPING,
            rise: 2.0,
            forcing: 0.1,
        }
    }

    /// Nielsen's rule: the damping falls to a third after a step as good as predicted, and rises after a poor one.
    pub(super) fn accepted(&mut self, gain: f64, change: f64) {
        let miss = 2.0 * gain - 1.0;
        self.damping = (self.damping * (1.0 - miss * miss * miss).max(1.0 / 3.0)).max(1e-30);
        self.rise = 2.0;
        self.forcing = change.clamp(1e-3, 0.1);
    }

    /// Raises the damping, each time by a larger factor.
    pub(super) fn rejected(&mut self) {
        self.damping *= self.rise;
        self.rise *= 2.0;
        self.forcing = self.forcing.min(1e-3);
    }
}

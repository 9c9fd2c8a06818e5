//! Levenberg-Marquardt minimisation of a few unknowns.

use nalgebra::{Const, DimMin, SMatrix, SVector};

/// Cost, half its gradient and its Gauss-Newton matrix at one state.
pub(crate) struct NormalEquations<const N: usize> {
    pub hessian: SMatrix<f64, N, N>,
    pub gradient: SVector<f64, N>,
    pub cost: f64,
}

impl<const N: usize> NormalEquations<N> {
    pub(crate) fn zero() -> Self {
        Self {
            hessian: SMatrix::zeros(),
            gradient: SVector::zeros(),
            cost: 0.0,
        }
    }

    /// Adds one residual under Cauchy's loss s² ln(1 + r² / s²), `scale2` = s².
    pub(crate) fn add(&mut self, residual: f64, slope: &SVector<f64, N>, scale2: f64) {
        self.add_weighed(residual, slope, 1.0 / (1.0 + residual * residual / scale2));
        self.cost += scale2 * libm::log1p(residual * residual / scale2);
    }

    /// Adds the derivatives of one residual at a given weight, without its cost.
    pub(crate) fn add_weighed(&mut self, residual: f64, slope: &SVector<f64, N>, weight: f64) {
        for j in 0..N {
            let weighed = weight * slope[j];
            self.gradient[j] += weighed * residual;
            for i in j..N {
                self.hessian[(i, j)] += weighed * slope[i];
            }
        }
    }
}

/// Returns the state after at most `steps` damped steps from `start`. `None` if the start has no finite cost.
///
/// Damping is relative to the diagonal, so the unknowns may have any units. Steps that raise the cost, or leave the
/// domain (`linearise` returns `None`), are rejected and the damping is multiplied by ten.
pub(crate) fn minimise<S: Clone, const N: usize>(
    start: &S,
    steps: usize,
    linearise: impl Fn(&S) -> Option<NormalEquations<N>>,
    moved: impl Fn(&S, &SVector<f64, N>) -> S,
) -> Option<S>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    let mut state = start.clone();
    let mut normal = linearise(&state).filter(|normal| normal.cost.is_finite())?;
    let mut damping = 1e-6;
    for _ in 0..steps {
        let Some(step) = damped_step(&normal, damping) else {
            damping *= 10.0;
            continue;
        };
        let candidate = moved(&state, &step);
        match linearise(&candidate).filter(|next| next.cost <= normal.cost) {
            Some(next) => {
                let gained = normal.cost - next.cost;
                (state, damping) = (candidate, (damping * 0.1).max(1e-12));
                // The remaining step is about 1e-4 of the standard deviation of the unknowns.
                let converged = gained <= 1e-8 * normal.cost;
                normal = next;
                if converged {
                    break;
                }
            }
            None => damping *= 10.0,
        }
        if damping > 1e8 {
            break;
        }
    }
    Some(state)
}

/// Returns the solution of (H + damping diag H) step = -gradient, solved in units in which the diagonal is 1.
fn damped_step<const N: usize>(normal: &NormalEquations<N>, damping: f64) -> Option<SVector<f64, N>> {
    let unit = normal
        .hessian
        .diagonal()
        .map(|value| if value > 0.0 { 1.0 / value.sqrt() } else { 1.0 });
    let mut system = normal.hessian;
    for j in 0..N {
        for i in j..N {
            system[(i, j)] *= unit[i] * unit[j];
        }
        // An unknown that no residual sees stays where it is.
        system[(j, j)] = 1.0 + damping;
    }
    let solved = system.cholesky()?.solve(&normal.gradient.component_mul(&unit));
    let step = -solved.component_mul(&unit);
    step.iter().all(|value| value.is_finite()).then_some(step)
}

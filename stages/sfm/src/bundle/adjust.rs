//! Levenberg-Marquardt: damped Gauss-Newton steps. The damping follows how well the last gain was predicted.

use super::normal_equations::NormalEquations;
use super::objective::Objective;
use super::options::{BundleOptions, BundleReport, Solver};
use super::problem::Problem;
use super::schur::{ReducedSystem, SchurComplement, predicted_gain};
use super::state::{Normalization, State, Step};
use super::step_control::StepControl;
use super::validate::{self, BundleError};
use super::{conjugate_gradients, dense};

/// Trials with ten times the damping when the matrix is not positive definite.
const MOST_FAILURES: usize = 10;

/// Root mean square residual that is only rounding, pixels (coordinates of 1e4 px times 2^-53, some operations).
const EXACT_PX: f64 = 1e-11;

/// Relative rounding error of the cost: some 1e4 terms of 2^-53.
const ROUNDING: f64 = 1e-12;

/// Adjusts poses, points and cameras in place so that the cost of observations and priors is smallest.
///
/// Levenberg-Marquardt with Marquardt's scaling and Nielsen's damping (1999), points eliminated (Schur complement),
/// robust losses by reweighting. Rotations are updated from the left, about the camera centre. The cost never rises
/// and no number becomes non-finite. Parameters that did not move keep their bits. `stop` is polled before
/// each step and within long ones. Once it is true, the best state so far is the result.
///
/// # Extremes
/// - An observation behind the camera, beyond the fold of the distortion or with an error above 1e9 px costs as much
///   as an error of the photo's diagonal, and contributes no gradient.
/// - A point without observations, or not determined by them (parallax below 1e-7 rad, one observation), is held. A
///   pose without observation and prior is held.
/// - f stays in [0.1, 10] times the longer side, |k|, |p| within 1. A step ends at the bound, and the parameter is
///   held from then on. A start outside may at most double.
///
/// # Errors
/// Lists of different lengths, indices out of range, numbers that are not finite, observations out of order.
pub fn adjust(
    problem: &mut Problem,
    options: &BundleOptions,
    stop: &dyn Fn() -> bool,
) -> Result<BundleReport, BundleError> {
    validate::check_options(options)?;
    validate::check(problem)?;
    let normalization = Normalization::new(problem);
    let start = State::new(problem, &normalization);
    let objective = Objective::new(problem, &normalization, options.loss, options.prior_loss);
    let (state, mut report) = descend(&objective, &start, options, stop);
    if report.final_cost < report.initial_cost {
        state.write(&start, &normalization, problem);
    } else {
        report.final_cost = report.initial_cost;
    }
    Ok(report)
}

/// Buffers of a step, allocated once.
struct Workspace {
    equations: NormalEquations,
    schur: SchurComplement,
    step: Step,
    matrix: Vec<f64>,
    conjugate_gradients: conjugate_gradients::Workspace,
}

/// Returns the state at which a step changes the cost by less than the tolerance, and the report.
fn descend(
    objective: &Objective,
    start: &State,
    options: &BundleOptions,
    stop: &dyn Fn() -> bool,
) -> (State, BundleReport) {
    let mut control = StepControl::new(objective.index.slots, options);
    let mut workspace = Workspace::new(objective);
    let (mut state, mut trial) = (start.clone(), start.clone());
    let mut report = BundleReport::new(objective, start);
    let exact = 0.5 * EXACT_PX * EXACT_PX * report.residuals as f64;
    let mut is_linearised = false;
    report.converged = report.final_cost <= exact;
    while !report.converged && report.iterations < options.max_iterations && !stop() {
        report.iterations += 1;
        if !is_linearised {
            workspace.equations.linearise(objective, &state);
            is_linearised = true;
        }
        if !workspace.solve(objective, &mut control, stop) {
            break;
        }
        trial.set_stepped(
            &state,
            &workspace.step,
            &objective.index,
            &objective.camera_bounds,
        );
        let cost = objective.cost(&trial);
        let expected = predicted_gain(objective, &workspace.equations, &workspace.step, control.damping);
        let gain = report.final_cost - cost;
        // The last step: its gain is below the rounding of the sum, but it still doubles the number of correct digits.
        let lost = expected <= ROUNDING * cost && gain.abs() <= ROUNDING * cost;
        if gain > 0.0 || lost {
            let change = gain / report.final_cost;
            control.accepted(gain / expected.max(f64::MIN_POSITIVE), change);
            std::mem::swap(&mut state, &mut trial);
            report.final_cost = cost;
            is_linearised = false;
            report.converged = change <= options.tolerance || cost <= exact || lost;
            continue;
        }
        control.rejected();
        report.converged = expected <= report.final_cost * f64::EPSILON;
    }
    report.hidden = objective.hidden(&state);
    (state, report)
}

impl BundleReport {
    fn new(objective: &Objective, start: &State) -> Self {
        let cost = objective.cost(start);
        Self {
            iterations: 0,
            initial_cost: cost,
            final_cost: cost,
            residuals: objective.residuals(),
            parameters: objective.index.parameters(),
            hidden: 0,
            converged: false,
        }
    }
}

impl Workspace {
    fn new(objective: &Objective) -> Self {
        Self {
            equations: NormalEquations::new(objective),
            schur: SchurComplement::new(objective),
            step: Step {
                reduced: vec![0.0; objective.index.unknowns()],
                points: vec![nalgebra::Vector3::zeros(); objective.problem.points.len()],
            },
            matrix: Vec::new(),
            conjugate_gradients: conjugate_gradients::Workspace::default(),
        }
    }

    /// Computes the step. False if none was found within the trials of the damping.
    fn solve(&mut self, objective: &Objective, control: &mut StepControl, stop: &dyn Fn() -> bool) -> bool {
        for _ in 0..=MOST_FAILURES {
            if stop() {
                return false;
            }
            self.schur.eliminate(objective, &self.equations, control.damping);
            if self.solve_reduced(objective, control, stop) {
                self.schur.substitute(objective, &mut self.step);
                if self.step.is_finite() {
                    return true;
                }
            }
            control.damping *= 10.0;
        }
        false
    }

    /// Solves the reduced system. False if there is no solution.
    fn solve_reduced(
        &mut self,
        objective: &Objective,
        control: &StepControl,
        stop: &dyn Fn() -> bool,
    ) -> bool {
        let solution = &mut self.step.reduced;
        let system = ReducedSystem {
            objective,
            equations: &self.equations,
            schur: &self.schur,
            damping: control.damping,
        };
        if control.solver == Solver::ConjugateGradients {
            let workspace = &mut self.conjugate_gradients;
            return conjugate_gradients::solve(&system, control.forcing, workspace, solution, stop);
        }
        dense::assemble(&system, &mut self.matrix);
        dense::solve(&mut self.matrix, &self.schur.right, solution, stop)
    }
}

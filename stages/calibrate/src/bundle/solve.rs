//! Levenberg-Marquardt: steps between Newton's and the gradient's, by how well the last one was foretold.

use super::schur::{Schur, predicted};
use super::state::{Frame, State, Step};
use super::system::System;
use super::task::Task;
use super::{BundleError, BundleOptions, BundleReport, Problem, Solver, check, dense, gradients};

/// Damping of the first step, as a share of the diagonal.
const FIRST_DAMPING: f64 = 1e-4;

/// Poses up to which the matrix is factored. A walk of 300 photos took 5 CPU s dense and 34 by conjugate gradients (15
/// steps, long chains converge slowly); at 600 a factorisation is 16 GFLOP and the matrix 104 MB.
const MOST_DENSE_POSES: usize = 600;

/// Trials with ten times the damping when the matrix is not positive.
const MOST_FAILURES: usize = 10;

/// Root mean square residual that is rounding, pixels (coordinates of 1e4 px times 2^-53, some operations).
const EXACT_PX: f64 = 1e-11;

/// Relative error of the cost: some 1e4 terms of 2^-53.
const ROUNDING: f64 = 1e-12;

/// Changes poses, points and cameras in place so that they explain observations and priors best.
///
/// Levenberg-Marquardt with Marquardt's scaling and Nielsen's damping (1999), points eliminated (Schur complement),
/// robust losses by reweighting. Rotations turn from the left, about the camera's centre. Never leaves the problem
/// worse than it was, never non-finite; what did not move keeps its bytes. `stop` is asked before each step.
///
/// # Extremes
/// - An observation behind the camera, beyond the fold or further than 1e9 px off costs as much as one that is off by
///   the photo's diagonal, and does not pull.
/// - A point without observation, or whose observations do not say where it is (parallax below 1e-7 rad, one
///   observation), stays. A pose without observation and prior stays.
/// - f stays in [0.1, 10] times the longer side, |k|, |p| within 1: a step ends there, and the term is held from then.
///   A start outside may at most double.
///
/// # Errors
/// Refuses lists that do not fit together, indices out of range, numbers not finite, observations out of order.
pub(crate) fn adjust(
    problem: &mut Problem,
    options: &BundleOptions,
    stop: &dyn Fn() -> bool,
) -> Result<BundleReport, BundleError> {
    check::check_options(options)?;
    check::check(problem)?;
    let frame = Frame::of(problem);
    let start = State::new(problem, &frame);
    let task = Task::new(problem, &frame, options.loss, options.prior_loss);
    let (state, mut report) = descend(&task, &start, options, stop);
    if report.final_cost < report.initial_cost {
        state.write(&start, &frame, problem);
    } else {
        report.final_cost = report.initial_cost;
    }
    Ok(report)
}

/// All that a step is computed in, made once.
struct Room {
    system: System,
    schur: Schur,
    step: Step,
    matrix: Vec<f64>,
    gradients: gradients::Room,
}

/// How the next step is computed.
struct Control {
    solver: Solver,
    damping: f64,
    /// Factor of the next rise of the damping.
    rise: f64,
    /// Accuracy asked of conjugate gradients.
    forcing: f64,
}

impl Control {
    fn new(task: &Task, options: &BundleOptions) -> Self {
        let solver = match options.solver {
            Solver::Auto if task.index.slots > MOST_DENSE_POSES => Solver::ConjugateGradients,
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

    /// Nielsen's rule: the damping falls to a third after a step as good as foretold, rises after a poor one.
    fn accepted(&mut self, gain: f64, change: f64) {
        let miss = 2.0 * gain - 1.0;
        self.damping = (self.damping * (1.0 - miss * miss * miss).max(1.0 / 3.0)).max(1e-30);
        self.rise = 2.0;
        self.forcing = change.clamp(1e-3, 0.1);
    }

    fn rejected(&mut self) {
        self.damping *= self.rise;
        self.rise *= 2.0;
        self.forcing = self.forcing.min(1e-3);
    }
}

/// Lowers the cost until a step changes it by less than the tolerance.
fn descend(
    task: &Task,
    start: &State,
    options: &BundleOptions,
    stop: &dyn Fn() -> bool,
) -> (State, BundleReport) {
    let mut control = Control::new(task, options);
    let mut room = Room::new(task);
    let (mut state, mut trial) = (start.clone(), start.clone());
    let mut report = BundleReport::new(task, start);
    let exact = 0.5 * EXACT_PX * EXACT_PX * report.residuals as f64;
    let mut linearised = Linearised::No;
    report.converged = report.final_cost <= exact;
    while !report.converged && report.iterations < options.max_iterations && !stop() {
        report.iterations += 1;
        if linearised == Linearised::No {
            room.system.linearise(task, &state);
            linearised = Linearised::Yes;
        }
        if !room.solve(task, &mut control) {
            break;
        }
        trial.set_moved(&state, &room.step, &task.index, &task.bounds);
        let cost = task.cost(&trial);
        let foretold = predicted(task, &room.system, &room.step, control.damping);
        let gain = report.final_cost - cost;
        // The last step of a descent: its gain is lost in the rounding of the sum, but it still doubles the digits.
        let lost = foretold <= ROUNDING * cost && gain.abs() <= ROUNDING * cost;
        if gain > 0.0 || lost {
            let change = gain / report.final_cost;
            control.accepted(gain / foretold.max(f64::MIN_POSITIVE), change);
            std::mem::swap(&mut state, &mut trial);
            report.final_cost = cost;
            linearised = Linearised::No;
            report.converged = change <= options.tolerance || cost <= exact || lost;
            continue;
        }
        control.rejected();
        report.converged = foretold <= report.final_cost * f64::EPSILON;
    }
    report.hidden = task.hidden(&state);
    (state, report)
}

/// Whether the normal equations are those of the present state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Linearised {
    No,
    Yes,
}

impl BundleReport {
    fn new(task: &Task, start: &State) -> Self {
        let cost = task.cost(start);
        Self {
            iterations: 0,
            initial_cost: cost,
            final_cost: cost,
            residuals: task.residuals(),
            parameters: task.index.parameters(),
            hidden: 0,
            converged: false,
        }
    }
}

impl Room {
    fn new(task: &Task) -> Self {
        Self {
            system: System::new(task),
            schur: Schur::new(task),
            step: Step {
                reduced: vec![0.0; task.index.unknowns()],
                points: vec![nalgebra::Vector3::zeros(); task.problem.points.len()],
            },
            matrix: Vec::new(),
            gradients: gradients::Room::default(),
        }
    }

    /// Sets the step; tells whether one was found within the trials of the damping.
    fn solve(&mut self, task: &Task, control: &mut Control) -> bool {
        for _ in 0..=MOST_FAILURES {
            self.schur.eliminate(task, &self.system, control.damping);
            if self.solve_reduced(task, control) {
                self.schur.substitute(task, &mut self.step);
                if self.step.is_finite() {
                    return true;
                }
            }
            control.damping *= 10.0;
        }
        false
    }

    fn solve_reduced(&mut self, task: &Task, control: &Control) -> bool {
        let (system, schur, solution) = (&self.system, &self.schur, &mut self.step.reduced);
        let damping = control.damping;
        if control.solver == Solver::ConjugateGradients {
            let (forcing, room) = (control.forcing, &mut self.gradients);
            return gradients::solve(task, system, schur, damping, forcing, room, solution);
        }
        dense::solve(task, system, schur, damping, &mut self.matrix, solution)
    }
}

//! Covariance of the poses.

use nalgebra::Matrix6;
use rayon::prelude::*;

use super::index::{NONE, POSE_PARAMS};
use super::loss::Loss;
use super::normal_equations::NormalEquations;
use super::objective::Objective;
use super::problem::{PoseFreedom, Prior, Problem};
use super::schur::{ReducedSystem, SchurComplement};
use super::state::{Normalization, State};
use super::{cholesky, dense, validate};

/// Largest number of unknowns: the dense matrix then takes 1.2 GB.
const MOST_UNKNOWNS: usize = 12_000;

/// A pivot below this, with the diagonal scaled to 1, is a direction in which the scene is not determined.
const PIVOT_FLOOR: f64 = 1e-11;

/// Returns the covariance of each pose: rotation from the left (radian), then centre (unit of the world).
///
/// σ² (JᵀJ)⁻¹ with points and free camera parameters marginalised, all observations with equal weight. Priors have
/// their own sigmas. `sigma_px`: standard deviation of one residual coordinate. Zero for a fixed pose, and in a fixed
/// coordinate. Points with less than two views, or seen from one position, do not contribute. `None` if a free pose
/// or lens is not determined (gauge not fixed), the problem is not valid, `sigma_px` is not positive, or there are
/// more than 12,000 unknowns. Also `None` once `stop` is true, which is polled in between.
pub fn pose_covariances(
    problem: &Problem,
    sigma_px: f64,
    stop: &(dyn Fn() -> bool + Sync),
) -> Option<Vec<Matrix6<f64>>> {
    let usable = sigma_px > 0.0 && sigma_px.is_finite() && validate::check(problem).is_ok();
    if !usable {
        return None;
    }
    let normalization = Normalization::new(problem);
    let mut objective = Objective::new(problem, &normalization, Loss::Squared, Loss::Squared);
    if !all_free_poses_observed(&objective) || objective.index.unknowns() > MOST_UNKNOWNS {
        return None;
    }
    // σ² (JᵀJ + σ² Σ priors)⁻¹: a prior counts in units of the observations' sigma.
    objective
        .priors
        .iter_mut()
        .for_each(|prior| shrink(prior, sigma_px));
    let state = State::new(problem, &normalization);
    let slots = blocks(&objective, &state, stop)?;
    let unit = [
        1.0,
        1.0,
        1.0,
        normalization.scale,
        normalization.scale,
        normalization.scale,
    ];
    let of_pose = |&slot: &u32| match slots.get(slot as usize) {
        Some(inside) => {
            let inside = inside * (sigma_px * sigma_px);
            Matrix6::from_fn(|row, column| inside[(row, column)] * unit[row] * unit[column])
        }
        None => Matrix6::zeros(),
    };
    let covariances: Vec<_> = objective.index.slot_of_pose.iter().map(of_pose).collect();
    let finite = covariances.iter().flatten().all(|value| value.is_finite());
    finite.then_some(covariances)
}

/// Returns the covariance of each pose from its own observations alone, with points, cameras and other poses held.
///
/// Units as in [`pose_covariances`]. `None` for a pose that its observations do not determine.
pub fn own_pose_covariances(problem: &Problem, sigma_px: f64) -> Vec<Option<Matrix6<f64>>> {
    let normalization = Normalization::new(problem);
    let objective = Objective::new(problem, &normalization, Loss::Squared, Loss::Squared);
    let mut equations = NormalEquations::new(&objective);
    equations.linearise_determined(&objective, &State::new(problem, &normalization));
    let slots = objective.index.slot_of_pose.iter();
    let covariance = |&slot: &u32| {
        let active = *objective.index.active_of_slot.get(slot as usize)?;
        let h = &equations.poses[active as usize].h;
        let inverse = Matrix6::from_fn(|row, column| h[row][column])
            .cholesky()?
            .inverse();
        Some(in_world_units(&inverse, sigma_px, normalization.scale))
    };
    slots.map(covariance).collect()
}

/// Returns a normalised inverse of the normal equations as a covariance in radian and units of the world.
fn in_world_units(inverse: &Matrix6<f64>, sigma_px: f64, scale: f64) -> Matrix6<f64> {
    let unit = |term: usize| if term < 3 { sigma_px } else { sigma_px * scale };
    Matrix6::from_fn(|row, column| inverse[(row, column)] * (unit(row) * unit(column)))
}

/// Whether every pose that is not fixed has unknowns.
fn all_free_poses_observed(objective: &Objective) -> bool {
    let freedom = objective
        .problem
        .pose_freedom
        .iter()
        .zip(&objective.index.slot_of_pose);
    freedom
        .into_iter()
        .all(|(freedom, &slot)| *freedom == PoseFreedom::Fixed || slot != NONE)
}

/// Whether some residual depends on every free parameter of every free pose.
fn all_parameters_observed(objective: &Objective, equations: &NormalEquations) -> bool {
    let slots = objective
        .index
        .active_of_slot
        .iter()
        .zip(&objective.index.held_axis);
    slots.into_iter().all(|(&active, held_axis)| {
        let held = held_axis.map(|axis| 3 + usize::from(axis));
        let h = &equations.poses[active as usize].h;
        (0..POSE_PARAMS).all(|term| h[term][term] > 0.0 || held == Some(term))
    })
}

/// Divides the sigmas of a prior.
fn shrink(prior: &mut Prior, factor: f64) {
    match prior {
        Prior::Centre { sigma, .. } => *sigma /= factor,
        Prior::Attitude { sigma_rad, .. } => *sigma_rad /= factor,
        Prior::Relative { sigma_rad, sigma, .. } => {
            *sigma_rad /= factor;
            *sigma /= factor;
        }
        Prior::Focal { sigma_share, .. } => *sigma_share /= factor,
    }
}

/// Returns the blocks of the inverse on its diagonal, slot by slot. `None` if the matrix is singular or on a stop.
fn blocks(
    objective: &Objective,
    state: &State,
    stop: &(dyn Fn() -> bool + Sync),
) -> Option<Vec<Matrix6<f64>>> {
    let ScaledMatrix { mut l, scale } = assembled(objective, state, stop)?;
    if !cholesky::factor(&mut l, scale.len(), PIVOT_FLOOR, stop) {
        return None;
    }
    let factor = ScaledMatrix { l, scale };
    (0..objective.index.slots)
        .into_par_iter()
        .map(|slot| (!stop()).then(|| block(objective, &factor, slot)))
        .collect()
}

/// The reduced matrix or its Cholesky factor, scaled to a unit diagonal.
struct ScaledMatrix {
    /// By rows, only the lower triangle is used.
    l: Vec<f64>,
    /// What rows and columns were multiplied by.
    scale: Vec<f64>,
}

/// Returns the undamped reduced matrix scaled to a unit diagonal. `None` if a free parameter is not observed or on a
/// stop.
fn assembled(objective: &Objective, state: &State, stop: &dyn Fn() -> bool) -> Option<ScaledMatrix> {
    let mut equations = NormalEquations::new(objective);
    equations.linearise_determined(objective, state);
    if stop() || !all_parameters_observed(objective, &equations) {
        return None;
    }
    let mut schur = SchurComplement::new(objective);
    schur.eliminate(objective, &equations, 0.0);
    if stop() {
        return None;
    }
    let mut l = Vec::new();
    let system = ReducedSystem {
        objective,
        equations: &equations,
        schur: &schur,
        damping: 0.0,
    };
    dense::assemble(&system, &mut l);
    let n = objective.index.unknowns();
    let scale: Vec<f64> = (0..n).map(|row| 1.0 / l[row * n + row].sqrt()).collect();
    for row in 0..n {
        for column in 0..=row {
            l[row * n + column] *= scale[row] * scale[column];
        }
    }
    Some(ScaledMatrix { l, scale })
}

/// Returns one 6 x 6 block of the inverse: (L⁻¹ E)ᵀ (L⁻¹ E), E the block's columns of the unit matrix.
fn block(objective: &Objective, factor: &ScaledMatrix, slot: usize) -> Matrix6<f64> {
    let (n, at) = (objective.index.unknowns(), objective.index.pose_at(slot));
    let columns: Vec<Vec<f64>> = (0..POSE_PARAMS)
        .map(|term| {
            let mut column = vec![0.0; n];
            column[at + term] = factor.scale[at + term];
            cholesky::forward(&factor.l, n, at, &mut column);
            column
        })
        .collect();
    let mut block =
        Matrix6::from_fn(|row, column| cholesky::dot(&columns[row][at..], &columns[column][at..]));
    if let Some(axis) = objective.index.held_axis[slot] {
        block.row_mut(3 + usize::from(axis)).fill(0.0);
        block.column_mut(3 + usize::from(axis)).fill(0.0);
    }
    block
}

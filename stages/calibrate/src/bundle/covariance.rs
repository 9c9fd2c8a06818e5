//! How well the observations determine each pose.

use nalgebra::Matrix6;
use rayon::prelude::*;

use super::index::{NONE, POSE_TERMS};
use super::schur::Schur;
use super::state::{Frame, State};
use super::system::System;
use super::task::Task;
use super::{Loss, Prior, Problem, check, cholesky, dense};

/// Unknowns at most: the dense matrix then takes 1.2 GB.
const MOST_UNKNOWNS: usize = 12_000;

/// A pivot below this share of its diagonal, unit diagonal, is a direction in which nothing holds the scene.
const PIVOT_FLOOR: f64 = 1e-11;

/// Returns the covariance of each pose: turn from the left (radian), then centre (unit of the world).
///
/// σ² (JᵀJ)⁻¹ with points and free lens terms left to vary, all observations weighted alike; the priors count with
/// their own sigmas. `sigma_px`: standard deviation of one residual coordinate. Zero for a pose that is held, and in
/// the coordinate that is held. Points with less than two views, or seen from one place, say nothing.
/// `None` where a free pose or lens is not determined (gauge not fixed), the problem is not valid, `sigma_px` is not
/// positive, or there are more than 12,000 unknowns.
pub(crate) fn pose_covariances(problem: &Problem, sigma_px: f64) -> Option<Vec<Matrix6<f64>>> {
    let usable = sigma_px > 0.0 && sigma_px.is_finite() && check::check(problem).is_ok();
    if !usable {
        return None;
    }
    let frame = Frame::of(problem);
    let mut task = Task::new(problem, &frame, Loss::Squared, Loss::Squared);
    if !all_touched(&task) || task.index.unknowns() > MOST_UNKNOWNS {
        return None;
    }
    // σ² (JᵀJ + σ² Σ priors)⁻¹: a prior counts in units of the observations' sigma.
    task.priors.iter_mut().for_each(|prior| shrink(prior, sigma_px));
    let factor = factored(&task, &State::new(problem, &frame))?;
    let slots: Vec<Matrix6<f64>> = (0..task.index.slots)
        .into_par_iter()
        .map(|slot| block(&task, &factor, slot) * (sigma_px * sigma_px))
        .collect();
    let unit = [1.0, 1.0, 1.0, frame.scale, frame.scale, frame.scale];
    let of_pose = |&slot: &u32| match slots.get(slot as usize) {
        Some(inside) => Matrix6::from_fn(|row, column| inside[(row, column)] * unit[row] * unit[column]),
        None => Matrix6::zeros(),
    };
    let covariances: Vec<_> = task.index.slot_of_pose.iter().map(of_pose).collect();
    let finite = covariances.iter().flatten().all(|value| value.is_finite());
    finite.then_some(covariances)
}

/// Tells whether every pose that is not held is in the system.
fn all_touched(task: &Task) -> bool {
    let freedom = task.problem.pose_freedom.iter().zip(&task.index.slot_of_pose);
    freedom
        .into_iter()
        .all(|(freedom, &slot)| *freedom == super::PoseFreedom::Fixed || slot != NONE)
}

/// Tells whether something depends on every number of every pose that moves, but a held coordinate.
fn all_pulled(task: &Task, system: &System) -> bool {
    let slots = task.index.active_of_slot.iter().zip(&task.index.held_axis);
    slots.into_iter().all(|(&active, held_axis)| {
        let held = held_axis.map(|axis| 3 + usize::from(axis));
        let h = &system.poses[active as usize].h;
        (0..POSE_TERMS).all(|term| h[term][term] > 0.0 || held == Some(term))
    })
}

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

/// The Cholesky factor of the undamped reduced matrix, scaled to a unit diagonal, and those scales.
struct Factor {
    l: Vec<f64>,
    scale: Vec<f64>,
}

fn factored(task: &Task, state: &State) -> Option<Factor> {
    let mut system = System::new(task);
    system.linearise_determined(task, state);
    if !all_pulled(task, &system) {
        return None;
    }
    let mut schur = Schur::new(task);
    schur.eliminate(task, &system, 0.0);
    let mut l = Vec::new();
    dense::assemble(task, &system, &schur, 0.0, &mut l);
    let n = task.index.unknowns();
    let scale: Vec<f64> = (0..n).map(|row| 1.0 / l[row * n + row].sqrt()).collect();
    for row in 0..n {
        for column in 0..=row {
            l[row * n + column] *= scale[row] * scale[column];
        }
    }
    cholesky::factor(&mut l, n, PIVOT_FLOOR).then_some(Factor { l, scale })
}

/// Returns one 6 x 6 block of the inverse: (L⁻¹ E)ᵀ (L⁻¹ E), E the block's columns of the unit matrix.
fn block(task: &Task, factor: &Factor, slot: usize) -> Matrix6<f64> {
    let (n, at) = (task.index.unknowns(), task.index.pose_at(slot));
    let columns: Vec<Vec<f64>> = (0..POSE_TERMS)
        .map(|term| {
            let mut column = vec![0.0; n];
            column[at + term] = factor.scale[at + term];
            cholesky::forward(&factor.l, n, at, &mut column);
            column
        })
        .collect();
    let mut block =
        Matrix6::from_fn(|row, column| cholesky::dot(&columns[row][at..], &columns[column][at..]));
    if let Some(axis) = task.index.held_axis[slot] {
        block.row_mut(3 + usize::from(axis)).fill(0.0);
        block.column_mut(3 + usize::from(axis)).fill(0.0);
    }
    block
}

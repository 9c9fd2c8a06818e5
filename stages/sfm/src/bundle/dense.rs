//! Solution of the reduced system as a dense matrix, by Cholesky factorisation.

use rayon::prelude::*;

use super::cholesky;
use super::index::POSE_PARAMS;
use super::objective::Objective;
use super::schur::{FreeBlock, ReducedSystem, SchurComplement, damped};

/// A pivot below this fraction of its diagonal is only rounding.
const PIVOT_FLOOR: f64 = 1e-15;

/// Sets `solution` to that of the assembled system. False if there is none. The matrix is left factored.
pub(super) fn solve(
    matrix: &mut [f64],
    right: &[f64],
    solution: &mut [f64],
    stop: &dyn Fn() -> bool,
) -> bool {
    let n = solution.len();
    if !cholesky::factor(matrix, n, PIVOT_FLOOR, stop) {
        return false;
    }
    solution.copy_from_slice(right);
    cholesky::solve(matrix, n, solution);
    true
}

/// Sets the lower triangle of H + damping D - Σ U Uᵀ: cameras first, then poses. Only pairs of photos that share a
/// point cost time.
pub(super) fn assemble(system: &ReducedSystem<'_>, matrix: &mut Vec<f64>) {
    let objective = system.objective;
    let n = objective.index.unknowns();
    matrix.resize(n * n, 0.0);
    let (cameras, poses) = matrix.split_at_mut(objective.index.camera_unknowns * n);
    assemble_cameras(system, cameras);
    let slots = poses.par_chunks_mut(POSE_PARAMS * n.max(1)).enumerate();
    slots.for_each(|(slot, rows)| assemble_pose(system, slot, rows));
    for cross in &system.equations.cross_blocks {
        let [first, second] = cross.slots;
        let (row, column) = (
            objective.index.pose_at(first.max(second)),
            objective.index.pose_at(first.min(second)),
        );
        let h = if first > second {
            cross.h
        } else {
            cross.h.transpose()
        };
        for (index, value) in h.transpose().iter().enumerate() {
            matrix[(row + index / POSE_PARAMS) * n + column + index % POSE_PARAMS] += value;
        }
    }
}

/// Sets the rows of the cameras.
fn assemble_cameras(system: &ReducedSystem<'_>, rows: &mut [f64]) {
    let &ReducedSystem {
        objective,
        equations,
        schur,
        damping,
    } = system;
    let index = &objective.index;
    let n = index.unknowns();
    rows.fill(0.0);
    for ((block, terms), &at) in equations.cameras.iter().zip(&index.terms).zip(&index.camera_at) {
        for row in 0..terms.len() {
            let target = &mut rows[(at + row) * n + at..][..=row];
            target.copy_from_slice(&block.h[row][..=row]);
            target[row] = damped(target[row], damping);
        }
    }
    for point in 0..objective.problem.points.len() {
        let point_cameras = index.point_cameras_of(point);
        for first in point_cameras.clone() {
            for second in point_cameras.start..=first {
                subtract_point_cameras(objective, schur, first, second, rows);
            }
        }
    }
}

/// Subtracts the product of two camera blocks of one point.
fn subtract_point_cameras(
    objective: &Objective,
    schur: &SchurComplement,
    first: usize,
    second: usize,
    rows: &mut [f64],
) {
    let index = &objective.index;
    let n = index.unknowns();
    let place = |point_camera: usize| {
        let camera = index.point_cameras[point_camera].camera as usize;
        (index.camera_at[camera], index.terms[camera].len())
    };
    let ((row_at, height), (column_at, width)) = (place(first), place(second));
    let (left, right) = (&schur.point_cameras[first], &schur.point_cameras[second]);
    for row in 0..height {
        let target = &mut rows[(row_at + row) * n + column_at..][..width];
        subtract_row(target, [left[0][row], left[1][row], left[2][row]], right);
    }
}

/// Sets the six rows of one pose, up to its own block.
fn assemble_pose(system: &ReducedSystem<'_>, slot: usize, rows: &mut [f64]) {
    let &ReducedSystem {
        objective,
        equations,
        schur,
        damping,
    } = system;
    let index = &objective.index;
    let n = index.unknowns();
    let active = index.active_of_slot[slot] as usize;
    let block = &equations.poses[active];
    let camera = objective.problem.camera_of_pose[index.active[active].pose as usize] as usize;
    let (camera_at, terms) = (index.camera_at[camera], index.terms[camera].len());
    let at = index.pose_at(slot);
    for (row, target) in rows.chunks_exact_mut(n).enumerate() {
        target[..at].fill(0.0);
        let by_camera = target[camera_at..camera_at + terms].iter_mut().zip(&block.mixed);
        by_camera.for_each(|(target, mixed)| *target = mixed[row]);
        target[at..at + POSE_PARAMS].copy_from_slice(&block.h[row]);
        target[at + row] = damped(target[at + row], damping);
    }
    for &free in index.free_of_slot.members(slot) {
        let left = &schur.free_observations[free as usize];
        let point = index.free_observations[free as usize].point as usize;
        for point_camera in index.point_cameras_of(point) {
            let camera = index.point_cameras[point_camera].camera as usize;
            let (at, terms) = (index.camera_at[camera], index.terms[camera].len());
            for (row, target) in rows.chunks_exact_mut(n).enumerate() {
                let left = [left[0][row], left[1][row], left[2][row]];
                subtract_row(
                    &mut target[at..at + terms],
                    left,
                    &schur.point_cameras[point_camera],
                );
            }
        }
        for other in index.free_of(point).start..=free as usize {
            let at = index.pose_at(index.free_observations[other].slot as usize);
            subtract_block(rows, n, at, left, &schur.free_observations[other]);
        }
    }
}

/// Subtracts one row of a product of two blocks.
#[inline]
fn subtract_row<const N: usize>(target: &mut [f64], left: [f64; 3], right: &[[f64; N]; 3]) {
    for (term, target) in target.iter_mut().enumerate().take(N) {
        *target -= left[0] * right[0][term] + left[1] * right[1][term] + left[2] * right[2][term];
    }
}

/// Subtracts U Uᵀ of two poses of one point. The innermost loop: 6 x 6 numbers, three products each.
#[inline]
fn subtract_block(rows: &mut [f64], n: usize, at: usize, left: &FreeBlock, right: &FreeBlock) {
    for row in 0..POSE_PARAMS {
        let target = &mut rows[row * n + at..][..POSE_PARAMS];
        for (term, target) in target.iter_mut().enumerate() {
            *target -=
                left[0][row] * right[0][term] + left[1][row] * right[1][term] + left[2][row] * right[2][term];
        }
    }
}

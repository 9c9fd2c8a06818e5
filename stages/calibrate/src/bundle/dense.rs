//! The reduced system as a dense matrix, solved by Cholesky factorisation.

use rayon::prelude::*;

use super::cholesky;
use super::index::POSE_TERMS;
use super::schur::{LinkBlock, Schur, damped};
use super::system::System;
use super::task::Task;

/// A pivot below this share of its diagonal is rounding.
const PIVOT_FLOOR: f64 = 1e-15;

/// Sets `solution` to the solution of the damped reduced system; tells whether there is one.
/// `matrix` is room for n² numbers.
pub(super) fn solve(
    task: &Task,
    system: &System,
    schur: &Schur,
    damping: f64,
    matrix: &mut Vec<f64>,
    solution: &mut [f64],
) -> bool {
    let n = solution.len();
    assemble(task, system, schur, damping, matrix);
    if !cholesky::factor(matrix, n, PIVOT_FLOOR) {
        return false;
    }
    solution.copy_from_slice(&schur.right);
    cholesky::solve(matrix, n, solution);
    true
}

/// Sets the lower triangle of H + damping D - Σ U Uᵀ: cameras first, then poses. Only pairs of photos that share a
/// point cost anything.
pub(super) fn assemble(task: &Task, system: &System, schur: &Schur, damping: f64, matrix: &mut Vec<f64>) {
    let n = task.index.unknowns();
    matrix.resize(n * n, 0.0);
    let (lenses, poses) = matrix.split_at_mut(task.index.camera_unknowns * n);
    assemble_lenses(task, system, schur, damping, lenses);
    let slots = poses.par_chunks_mut(POSE_TERMS * n.max(1)).enumerate();
    slots.for_each(|(slot, rows)| assemble_pose(task, system, schur, damping, slot, rows));
    for tie in &system.ties {
        let [first, second] = tie.slots;
        let (row, column) = (
            task.index.pose_at(first.max(second)),
            task.index.pose_at(first.min(second)),
        );
        let h = if first > second { tie.h } else { tie.h.transpose() };
        for (index, value) in h.transpose().iter().enumerate() {
            matrix[(row + index / POSE_TERMS) * n + column + index % POSE_TERMS] += value;
        }
    }
}

fn assemble_lenses(task: &Task, system: &System, schur: &Schur, damping: f64, rows: &mut [f64]) {
    let index = &task.index;
    let n = index.unknowns();
    rows.fill(0.0);
    for ((block, terms), &at) in system.cameras.iter().zip(&index.terms).zip(&index.camera_at) {
        for row in 0..terms.len() {
            let target = &mut rows[(at + row) * n + at..][..=row];
            target.copy_from_slice(&block.h[row][..=row]);
            target[row] = damped(target[row], damping);
        }
    }
    for point in 0..task.problem.points.len() {
        let couples = index.couples_of(point);
        for first in couples.clone() {
            for second in couples.start..=first {
                subtract_couples(task, schur, first, second, rows);
            }
        }
    }
}

fn subtract_couples(task: &Task, schur: &Schur, first: usize, second: usize, rows: &mut [f64]) {
    let index = &task.index;
    let n = index.unknowns();
    let place = |couple: usize| {
        let camera = index.couples[couple].camera as usize;
        (index.camera_at[camera], index.terms[camera].len())
    };
    let ((row_at, height), (column_at, width)) = (place(first), place(second));
    let (left, right) = (&schur.couples[first], &schur.couples[second]);
    for row in 0..height {
        let target = &mut rows[(row_at + row) * n + column_at..][..width];
        subtract_row(target, [left[0][row], left[1][row], left[2][row]], right);
    }
}

/// Sets the six rows of one pose, up to its own block.
fn assemble_pose(task: &Task, system: &System, schur: &Schur, damping: f64, slot: usize, rows: &mut [f64]) {
    let index = &task.index;
    let n = index.unknowns();
    let active = index.active_of_slot[slot] as usize;
    let block = &system.poses[active];
    let camera = task.problem.camera_of_pose[index.active[active].pose as usize] as usize;
    let (camera_at, terms) = (index.camera_at[camera], index.terms[camera].len());
    let at = index.pose_at(slot);
    for (row, target) in rows.chunks_exact_mut(n).enumerate() {
        target[..at].fill(0.0);
        let by_lens = target[camera_at..camera_at + terms].iter_mut().zip(&block.mixed);
        by_lens.for_each(|(target, mixed)| *target = mixed[row]);
        target[at..at + POSE_TERMS].copy_from_slice(&block.h[row]);
        target[at + row] = damped(target[at + row], damping);
    }
    for &link in index.links_of_slot.of(slot) {
        let left = &schur.links[link as usize];
        let point = index.links[link as usize].point as usize;
        for couple in index.couples_of(point) {
            let camera = index.couples[couple].camera as usize;
            let (at, terms) = (index.camera_at[camera], index.terms[camera].len());
            for (row, target) in rows.chunks_exact_mut(n).enumerate() {
                let left = [left[0][row], left[1][row], left[2][row]];
                subtract_row(&mut target[at..at + terms], left, &schur.couples[couple]);
            }
        }
        for other in index.links_of(point).start..=link as usize {
            let at = index.pose_at(index.links[other].slot as usize);
            subtract_block(rows, n, at, left, &schur.links[other]);
        }
    }
}

#[inline]
fn subtract_row<const N: usize>(target: &mut [f64], left: [f64; 3], right: &[[f64; N]; 3]) {
    for (term, target) in target.iter_mut().enumerate().take(N) {
        *target -= left[0] * right[0][term] + left[1] * right[1][term] + left[2] * right[2][term];
    }
}

/// The hot loop: 6 x 6 numbers, three products each.
#[inline]
fn subtract_block(rows: &mut [f64], n: usize, at: usize, left: &LinkBlock, right: &LinkBlock) {
    for row in 0..POSE_TERMS {
        let target = &mut rows[row * n + at..][..POSE_TERMS];
        for (term, target) in target.iter_mut().enumerate() {
            *target -=
                left[0][row] * right[0][term] + left[1][row] * right[1][term] + left[2][row] * right[2][term];
        }
    }
}

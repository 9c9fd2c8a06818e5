//! Elimination of the points from the normal equations (Schur complement), point by point.
//!
//! V = L Lᵀ is the damped 3 x 3 block of a point, W its 6 x 3 block to a pose, and U = W L⁻ᵀ. The reduced matrix is H
//! - Σ U Uᵀ over pairs of photos that share a point. The reduced right side is g - Σ U y with y = L⁻¹ g_point.

use rayon::prelude::*;

use super::cholesky3::{backward, factor, forward, inverse};
use super::index::{FreeObservation, POSE_PARAMS, PointCamera};
use super::normal_equations::{GRAIN, NormalEquations, PointBlock, pose_columns};
use super::objective::Objective;
use super::residual::CAMERA_PARAMS;
use super::state::Step;

/// Uᵀ of a pose and a point: 3 rows.
pub(super) type FreeBlock = [[f64; POSE_PARAMS]; 3];
/// Uᵀ of a camera and a point: 3 rows.
pub(super) type PointCameraBlock = [[f64; CAMERA_PARAMS]; 3];

/// L⁻¹ (lower triangle by rows) and y of a point. Zero if it is held.
#[derive(Debug, Clone, Copy, Default)]
struct PointFactor {
    inverse: [f64; 6],
    y: [f64; 3],
}

/// The eliminated points for one damping.
#[derive(Debug, Default)]
pub(super) struct SchurComplement {
    points: Vec<PointFactor>,
    pub free_observations: Vec<FreeBlock>,
    pub point_cameras: Vec<PointCameraBlock>,
    /// Right side of the reduced system.
    pub right: Vec<f64>,
}

/// Returns a diagonal element with its damping: h + damping · h, h clamped to [1e-6, 1e32] in the second term.
/// Where nothing depends on a parameter the element is 1, so that its step is 0.
#[inline]
pub(super) fn damped(h: f64, damping: f64) -> f64 {
    if h == 0.0 { 1.0 } else { h + damping * scale(h) }
}

/// Returns the scale of the damping of a diagonal element.
fn scale(h: f64) -> f64 {
    h.clamp(1e-6, 1e32)
}

/// The damped reduced system.
pub(super) struct ReducedSystem<'a> {
    pub objective: &'a Objective<'a>,
    pub equations: &'a NormalEquations,
    pub schur: &'a SchurComplement,
    pub damping: f64,
}

impl SchurComplement {
    pub(super) fn new(objective: &Objective) -> Self {
        Self {
            points: vec![PointFactor::default(); objective.problem.points.len()],
            free_observations: vec![FreeBlock::default(); objective.index.free_observations.len()],
            point_cameras: vec![PointCameraBlock::default(); objective.index.point_cameras.len()],
            right: vec![0.0; objective.index.unknowns()],
        }
    }

    /// Eliminates the points of normal equations for a damping.
    pub(super) fn eliminate(&mut self, objective: &Objective, equations: &NormalEquations, damping: f64) {
        let points = self.points.par_iter_mut().zip(&equations.points);
        points
            .with_min_len(GRAIN)
            .for_each(|(factor, block)| *factor = point_factor(block, damping));
        let points = &self.points;
        let free_observations = self
            .free_observations
            .par_iter_mut()
            .zip(&objective.index.free_observations);
        free_observations
            .with_min_len(GRAIN)
            .for_each(|(block, free)| *block = free_block(objective, equations, points, free));
        let point_cameras = self
            .point_cameras
            .par_iter_mut()
            .zip(&objective.index.point_cameras);
        point_cameras
            .with_min_len(GRAIN)
            .for_each(|(block, point_camera)| {
                *block = point_camera_block(objective, equations, points, point_camera)
            });
        self.set_right(objective, equations);
    }

    /// Computes the right side of the reduced system.
    fn set_right(&mut self, objective: &Objective, equations: &NormalEquations) {
        let index = &objective.index;
        let (cameras, poses) = self.right.split_at_mut(index.camera_unknowns);
        let mut of_cameras: Vec<_> = equations.cameras.iter().map(|block| block.g).collect();
        for (block, point_camera) in self.point_cameras.iter().zip(&index.point_cameras) {
            let y = &self.points[point_camera.point as usize].y;
            subtract_transposed(&mut of_cameras[point_camera.camera as usize], block, y);
        }
        index.place(&of_cameras, cameras);
        let (points, free_observations) = (&self.points, &self.free_observations);
        let slots = poses.par_chunks_mut(POSE_PARAMS).enumerate();
        slots.for_each(|(slot, right)| {
            let mut sum = equations.poses[index.active_of_slot[slot] as usize].g;
            for &free in index.free_of_slot.members(slot) {
                let point = index.free_observations[free as usize].point as usize;
                subtract_transposed(&mut sum, &free_observations[free as usize], &points[point].y);
            }
            right.copy_from_slice(&sum);
        });
    }

    /// Returns Uᵀ p of one point, summed over all poses and cameras that observe it.
    #[inline]
    pub(super) fn gathered(&self, objective: &Objective, point: usize, reduced: &[f64]) -> [f64; 3] {
        let index = &objective.index;
        let (mut of_poses, mut of_cameras) = (FreeBlock::default(), PointCameraBlock::default());
        let free_observations = index.free_of(point);
        for (block, free) in self.free_observations[free_observations.clone()]
            .iter()
            .zip(&index.free_observations[free_observations])
        {
            let at = index.pose_at(free.slot as usize);
            add_products(&mut of_poses, block, &padded(reduced, at, POSE_PARAMS));
        }
        let point_cameras = index.point_cameras_of(point);
        for (block, point_camera) in self.point_cameras[point_cameras.clone()]
            .iter()
            .zip(&index.point_cameras[point_cameras])
        {
            let camera = point_camera.camera as usize;
            let vector = padded(reduced, index.camera_at[camera], index.terms[camera].len());
            add_products(&mut of_cameras, block, &vector);
        }
        [0, 1, 2].map(|row| of_poses[row].iter().sum::<f64>() + of_cameras[row].iter().sum::<f64>())
    }

    /// Computes the steps of the points from those of poses and cameras (back substitution).
    pub(super) fn substitute(&self, objective: &Objective, step: &mut Step) {
        let reduced = &step.reduced;
        let points = step.points.par_iter_mut().zip(&self.points).enumerate();
        points.with_min_len(GRAIN).for_each(|(point, (step, factor))| {
            let gathered = self.gathered(objective, point, reduced);
            let rest = [0, 1, 2].map(|row| factor.y[row] - gathered[row]);
            *step = backward(&factor.inverse, &rest);
        });
    }
}

/// Returns the gain that the damped model predicts for its step: ½ δᵀ (g + damping D δ).
pub(super) fn predicted_gain(
    objective: &Objective,
    equations: &NormalEquations,
    step: &Step,
    damping: f64,
) -> f64 {
    let gain = |step: f64, g: f64, h: f64| step * (g + damping * scale(h) * step);
    let mut sum = 0.0;
    for (step, block) in step.points.iter().zip(&equations.points) {
        let [x, _, y, _, _, z] = block.h;
        sum += gain(step.x, block.g[0], x) + gain(step.y, block.g[1], y) + gain(step.z, block.g[2], z);
    }
    for (camera, terms) in objective.index.terms.iter().enumerate() {
        let (block, at) = (&equations.cameras[camera], objective.index.camera_at[camera]);
        for term in 0..terms.len() {
            sum += gain(step.reduced[at + term], block.g[term], block.h[term][term]);
        }
    }
    for (slot, &active) in objective.index.active_of_slot.iter().enumerate() {
        let (block, at) = (&equations.poses[active as usize], objective.index.pose_at(slot));
        for term in 0..POSE_PARAMS {
            sum += gain(step.reduced[at + term], block.g[term], block.h[term][term]);
        }
    }
    0.5 * sum
}

/// Returns the inverse factor and y of a point. Zero if it is not determined.
fn point_factor(block: &PointBlock, damping: f64) -> PointFactor {
    if !block.is_determined {
        return PointFactor::default();
    }
    let mut h = block.h;
    for diagonal in [0, 2, 5] {
        h[diagonal] = damped(h[diagonal], damping);
    }
    let Some(lower) = factor(&h) else {
        return PointFactor::default();
    };
    let inverse = inverse(lower);
    PointFactor {
        inverse,
        y: forward(&inverse, &block.g),
    }
}

/// Returns Uᵀ of a free pose and a point.
#[inline]
fn free_block(
    objective: &Objective,
    equations: &NormalEquations,
    points: &[PointFactor],
    free: &FreeObservation,
) -> FreeBlock {
    let row = &equations.rows[free.observation as usize];
    let columns = pose_columns(row, objective.index.held_axis[free.slot as usize]);
    let inverse = &points[free.point as usize].inverse;
    let [first, second] = [forward(inverse, &row.point[0]), forward(inverse, &row.point[1])];
    [0, 1, 2].map(|m| {
        let mut block = [0.0; POSE_PARAMS];
        for (term, block) in block.iter_mut().enumerate() {
            *block = first[m] * columns[0][term] + second[m] * columns[1][term];
        }
        block
    })
}

/// Returns Uᵀ of a camera and a point, summed over its observations.
fn point_camera_block(
    objective: &Objective,
    equations: &NormalEquations,
    points: &[PointFactor],
    point_camera: &PointCamera,
) -> PointCameraBlock {
    let mut block = PointCameraBlock::default();
    let inverse = &points[point_camera.point as usize].inverse;
    let terms = objective.index.terms[point_camera.camera as usize].len();
    for observation in objective.index.observations_of(point_camera.point as usize) {
        if objective.camera_of(&objective.problem.observations[observation]) != point_camera.camera as usize {
            continue;
        }
        let row = &equations.rows[observation];
        for (by_point, by_camera) in row.point.iter().zip(&equations.camera_jacobians[observation]) {
            let turned = forward(inverse, by_point);
            for (block, turned) in block.iter_mut().zip(turned) {
                let both = block.iter_mut().zip(by_camera).take(terms);
                both.for_each(|(block, by_camera)| *block += turned * by_camera);
            }
        }
    }
    block
}

/// right -= U y, U given as Uᵀ.
#[inline]
pub(super) fn subtract_transposed<const N: usize>(right: &mut [f64; N], block: &[[f64; N]; 3], y: &[f64; 3]) {
    let [first, second, third] = block;
    for (term, right) in right.iter_mut().enumerate() {
        *right -= first[term] * y[0] + second[term] * y[1] + third[term] * y[2];
    }
}

/// sums += Uᵀ times the diagonal matrix of a vector. The sums of its rows are Uᵀ v.
#[inline]
fn add_products<const N: usize>(sums: &mut [[f64; N]; 3], block: &[[f64; N]; 3], vector: &[f64; N]) {
    for (sums, row) in sums.iter_mut().zip(block) {
        for ((sum, left), right) in sums.iter_mut().zip(row).zip(vector) {
            *sum += left * right;
        }
    }
}

/// Returns `count` numbers of a slice from `at`, padded with zeros.
#[inline]
pub(super) fn padded<const N: usize>(from: &[f64], at: usize, count: usize) -> [f64; N] {
    let mut padded = [0.0; N];
    padded
        .iter_mut()
        .zip(&from[at..at + count])
        .for_each(|(to, from)| *to = *from);
    padded
}

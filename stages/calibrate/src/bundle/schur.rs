//! The points taken out of the normal equations (Schur complement), point by point.
//!
//! With V = L Lᵀ the damped 3 x 3 of a point and W its 6 x 3 to a pose, U = W L⁻ᵀ: the reduced matrix is
//! H - Σ U Uᵀ over pairs of photos that share a point, the reduced right side g - Σ U y with y = L⁻¹ g_point.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::index::{Couple, Link, POSE_TERMS};
use super::sight::LENS_TERMS;
use super::state::Step;
use super::system::{Determined, GRAIN, PointBlock, System, pose_columns};
use super::task::Task;

/// Uᵀ of a pose and a point: 3 rows.
pub(super) type LinkBlock = [[f64; POSE_TERMS]; 3];
/// Uᵀ of a camera and a point.
pub(super) type CoupleBlock = [[f64; LENS_TERMS]; 3];

/// L⁻¹ (lower triangle by rows) and y of a point; zero where it is held.
#[derive(Debug, Clone, Copy, Default)]
struct PointFactor {
    inverse: [f64; 6],
    y: [f64; 3],
}

/// The eliminated points under one damping.
#[derive(Debug, Default)]
pub(super) struct Schur {
    points: Vec<PointFactor>,
    pub links: Vec<LinkBlock>,
    pub couples: Vec<CoupleBlock>,
    /// Right side of the reduced system.
    pub right: Vec<f64>,
}

/// Returns a diagonal element with its damping: h + damping · h, h clamped to [1e-6, 1e32] in the second term.
/// Where nothing depends on a number the element is 1, so that its step is 0.
#[inline]
pub(super) fn damped(h: f64, damping: f64) -> f64 {
    if h == 0.0 { 1.0 } else { h + damping * scale(h) }
}

fn scale(h: f64) -> f64 {
    h.clamp(1e-6, 1e32)
}

/// Returns the lower Cholesky factor of a symmetric 3 x 3 (xx, yx, yy, zx, zy, zz), `None` if it is not positive.
#[inline]
pub(super) fn factor(h: &[f64; 6]) -> Option<[f64; 6]> {
    let positive = |value: f64| (value > 0.0).then(|| value.sqrt());
    let xx = positive(h[0])?;
    let (yx, zx) = (h[1] / xx, h[3] / xx);
    let yy = positive(h[2] - yx * yx)?;
    let zy = (h[4] - zx * yx) / yy;
    let zz = positive(h[5] - zx * zx - zy * zy)?;
    Some([xx, yx, yy, zx, zy, zz])
}

/// Returns the inverse of a lower triangle.
#[inline]
fn inverse(lower: [f64; 6]) -> [f64; 6] {
    let [xx, yx, yy, zx, zy, zz] = lower;
    let (xx, yy, zz) = (1.0 / xx, 1.0 / yy, 1.0 / zz);
    let yx = -yx * xx * yy;
    [xx, yx, yy, -(zx * xx + zy * yx) * zz, -zy * yy * zz, zz]
}

/// Returns L⁻¹ v.
#[inline]
fn forward(inverse: &[f64; 6], v: &[f64; 3]) -> [f64; 3] {
    [
        inverse[0] * v[0],
        inverse[1] * v[0] + inverse[2] * v[1],
        inverse[3] * v[0] + inverse[4] * v[1] + inverse[5] * v[2],
    ]
}

/// Returns L⁻ᵀ v.
#[inline]
fn backward(inverse: &[f64; 6], v: &[f64; 3]) -> Vector3<f64> {
    Vector3::new(
        inverse[0] * v[0] + inverse[1] * v[1] + inverse[3] * v[2],
        inverse[2] * v[1] + inverse[4] * v[2],
        inverse[5] * v[2],
    )
}

impl Schur {
    pub(super) fn new(task: &Task) -> Self {
        Self {
            points: vec![PointFactor::default(); task.problem.points.len()],
            links: vec![LinkBlock::default(); task.index.links.len()],
            couples: vec![CoupleBlock::default(); task.index.couples.len()],
            right: vec![0.0; task.index.unknowns()],
        }
    }

    /// Eliminates the points of a linearised system under a damping.
    pub(super) fn eliminate(&mut self, task: &Task, system: &System, damping: f64) {
        let points = self.points.par_iter_mut().zip(&system.points);
        points
            .with_min_len(GRAIN)
            .for_each(|(factor, block)| *factor = point_factor(block, damping));
        let points = &self.points;
        let links = self.links.par_iter_mut().zip(&task.index.links);
        links
            .with_min_len(GRAIN)
            .for_each(|(block, link)| *block = link_block(task, system, points, link));
        let couples = self.couples.par_iter_mut().zip(&task.index.couples);
        couples
            .with_min_len(GRAIN)
            .for_each(|(block, couple)| *block = couple_block(task, system, points, couple));
        self.set_right(task, system);
    }

    fn set_right(&mut self, task: &Task, system: &System) {
        let index = &task.index;
        let (lenses, poses) = self.right.split_at_mut(index.camera_unknowns);
        let mut of_cameras: Vec<_> = system.cameras.iter().map(|block| block.g).collect();
        for (block, couple) in self.couples.iter().zip(&index.couples) {
            let y = &self.points[couple.point as usize].y;
            subtract_transposed(&mut of_cameras[couple.camera as usize], block, y);
        }
        index.place(&of_cameras, lenses);
        let (points, links) = (&self.points, &self.links);
        let slots = poses.par_chunks_mut(POSE_TERMS).enumerate();
        slots.for_each(|(slot, right)| {
            let mut sum = system.poses[index.active_of_slot[slot] as usize].g;
            for &link in index.links_of_slot.of(slot) {
                let point = index.links[link as usize].point as usize;
                subtract_transposed(&mut sum, &links[link as usize], &points[point].y);
            }
            right.copy_from_slice(&sum);
        });
    }

    /// Returns Uᵀ p of one point, summed over all photos and cameras that see it.
    #[inline]
    pub(super) fn gathered(&self, task: &Task, point: usize, reduced: &[f64]) -> [f64; 3] {
        let index = &task.index;
        let (mut of_poses, mut of_lenses) = (LinkBlock::default(), CoupleBlock::default());
        let links = index.links_of(point);
        for (block, link) in self.links[links.clone()].iter().zip(&index.links[links]) {
            let at = index.pose_at(link.slot as usize);
            add_products(&mut of_poses, block, &taken(reduced, at, POSE_TERMS));
        }
        let couples = index.couples_of(point);
        for (block, couple) in self.couples[couples.clone()].iter().zip(&index.couples[couples]) {
            let camera = couple.camera as usize;
            let vector = taken(reduced, index.camera_at[camera], index.terms[camera].len());
            add_products(&mut of_lenses, block, &vector);
        }
        [0, 1, 2].map(|row| of_poses[row].iter().sum::<f64>() + of_lenses[row].iter().sum::<f64>())
    }

    /// Sets the steps of the points that follow from those of poses and cameras.
    pub(super) fn substitute(&self, task: &Task, step: &mut Step) {
        let reduced = &step.reduced;
        let points = step.points.par_iter_mut().zip(&self.points).enumerate();
        points.with_min_len(GRAIN).for_each(|(point, (step, factor))| {
            let gathered = self.gathered(task, point, reduced);
            let rest = [0, 1, 2].map(|row| factor.y[row] - gathered[row]);
            *step = backward(&factor.inverse, &rest);
        });
    }
}

/// Returns by how much the damped model says a step lowers the cost: ½ δᵀ (g + damping D δ), where δ solves it.
pub(super) fn predicted(task: &Task, system: &System, step: &Step, damping: f64) -> f64 {
    let gain = |step: f64, g: f64, h: f64| step * (g + damping * scale(h) * step);
    let mut sum = 0.0;
    for (step, block) in step.points.iter().zip(&system.points) {
        let [x, _, y, _, _, z] = block.h;
        sum += gain(step.x, block.g[0], x) + gain(step.y, block.g[1], y) + gain(step.z, block.g[2], z);
    }
    for (camera, terms) in task.index.terms.iter().enumerate() {
        let (block, at) = (&system.cameras[camera], task.index.camera_at[camera]);
        for term in 0..terms.len() {
            sum += gain(step.reduced[at + term], block.g[term], block.h[term][term]);
        }
    }
    for (slot, &active) in task.index.active_of_slot.iter().enumerate() {
        let (block, at) = (&system.poses[active as usize], task.index.pose_at(slot));
        for term in 0..POSE_TERMS {
            sum += gain(step.reduced[at + term], block.g[term], block.h[term][term]);
        }
    }
    0.5 * sum
}

fn point_factor(block: &PointBlock, damping: f64) -> PointFactor {
    if block.determined == Determined::No {
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

#[inline]
fn link_block(task: &Task, system: &System, points: &[PointFactor], link: &Link) -> LinkBlock {
    let row = &system.rows[link.observation as usize];
    let columns = pose_columns(row, task.index.held_axis[link.slot as usize]);
    let inverse = &points[link.point as usize].inverse;
    let [first, second] = [forward(inverse, &row.point[0]), forward(inverse, &row.point[1])];
    [0, 1, 2].map(|m| {
        let mut block = [0.0; POSE_TERMS];
        for (term, block) in block.iter_mut().enumerate() {
            *block = first[m] * columns[0][term] + second[m] * columns[1][term];
        }
        block
    })
}

fn couple_block(task: &Task, system: &System, points: &[PointFactor], couple: &Couple) -> CoupleBlock {
    let mut block = CoupleBlock::default();
    let inverse = &points[couple.point as usize].inverse;
    let terms = task.index.terms[couple.camera as usize].len();
    for observation in task.index.observations_of(couple.point as usize) {
        if task.camera_of(&task.problem.observations[observation]) != couple.camera as usize {
            continue;
        }
        let row = &system.rows[observation];
        for (by_point, by_lens) in row.point.iter().zip(&system.lens_rows[observation]) {
            let turned = forward(inverse, by_point);
            for (block, turned) in block.iter_mut().zip(turned) {
                let both = block.iter_mut().zip(by_lens).take(terms);
                both.for_each(|(block, by_lens)| *block += turned * by_lens);
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

/// sums += Uᵀ times the diagonal matrix of a vector: its rows' sums, added up later, are Uᵀ v.
#[inline]
fn add_products<const N: usize>(sums: &mut [[f64; N]; 3], block: &[[f64; N]; 3], vector: &[f64; N]) {
    for (sums, row) in sums.iter_mut().zip(block) {
        for ((sum, left), right) in sums.iter_mut().zip(row).zip(vector) {
            *sum += left * right;
        }
    }
}

/// Returns the numbers of a slice from `at`, zero beyond `count`.
#[inline]
pub(super) fn taken<const N: usize>(from: &[f64], at: usize, count: usize) -> [f64; N] {
    let mut taken = [0.0; N];
    taken
        .iter_mut()
        .zip(&from[at..at + count])
        .for_each(|(to, from)| *to = *from);
    taken
}

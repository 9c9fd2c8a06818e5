//! The normal equations at one state: JᵀJ and -Jᵀr, by point, pose and camera, without damping.

use nalgebra::{Matrix6, Vector6};
use rayon::prelude::*;

use super::index::{Active, NONE, POSE_TERMS};
use super::sight::{LENS_TERMS, LensRow, Row, Term, sight};
use super::state::State;
use super::task::{Task, near};
use super::{Observation, Prior, index, priors};

/// Fewest items worth a thread of their own.
pub(super) const GRAIN: usize = 1024;

/// A pivot this much below its diagonal is rounding: the parallax of the point is below 1e-7 rad.
const SINGULAR: f64 = 1e-14;

/// Normal equations of one point; zero where it is held.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PointBlock {
    /// xx, yx, yy, zx, zy, zz.
    pub h: [f64; 6],
    pub g: [f64; 3],
    pub determined: Determined,
}

/// Whether the observations say where a point is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Determined {
    #[default]
    No,
    Yes,
}

/// Normal equations of one pose, its share of its camera's, and what couples the two.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PoseBlock {
    pub h: [[f64; POSE_TERMS]; POSE_TERMS],
    pub g: [f64; POSE_TERMS],
    /// Rows of the lens, columns of the pose.
    pub mixed: [[f64; POSE_TERMS]; LENS_TERMS],
    pub lens: CameraBlock,
}

/// Normal equations of one camera.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct CameraBlock {
    pub h: [[f64; LENS_TERMS]; LENS_TERMS],
    pub g: [f64; LENS_TERMS],
}

/// A prior between two poses that both may move.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tie {
    pub slots: [usize; 2],
    /// JᵀJ, rows of the first, columns of the second.
    pub h: Matrix6<f64>,
}

/// All normal equations and the rows they were summed from.
#[derive(Debug, Default)]
pub(super) struct System {
    pub rows: Vec<Row>,
    /// Empty when no lens may move.
    pub lens_rows: Vec<LensRow>,
    pub points: Vec<PointBlock>,
    /// Of the active poses ([`Active`]).
    pub poses: Vec<PoseBlock>,
    pub cameras: Vec<CameraBlock>,
    pub ties: Vec<Tie>,
}

impl System {
    pub(super) fn new(task: &Task) -> Self {
        let observations = task.problem.observations.len();
        let lens_rows = if task.index.camera_unknowns == 0 {
            0
        } else {
            observations
        };
        Self {
            rows: vec![Row::default(); observations],
            lens_rows: vec![LensRow::default(); lens_rows],
            points: vec![PointBlock::default(); task.problem.points.len()],
            poses: vec![PoseBlock::default(); task.index.active.len()],
            cameras: vec![CameraBlock::default(); task.problem.cameras.len()],
            ties: Vec::new(),
        }
    }

    /// Sums everything anew at a state.
    pub(super) fn linearise(&mut self, task: &Task, state: &State) {
        self.set_rows(task, state);
        self.set_points(task);
        self.set_poses(task);
        self.add_priors(task, state);
    }

    /// Sums everything but the observations of points that those leave undetermined: they say nothing.
    pub(super) fn linearise_determined(&mut self, task: &Task, state: &State) {
        self.set_rows(task, state);
        self.set_points(task);
        for (point, block) in self.points.iter().enumerate() {
            if block.determined == Determined::No {
                let seen = task.index.observations_of(point);
                self.rows[seen.clone()].fill(Row::default());
                if !self.lens_rows.is_empty() {
                    self.lens_rows[seen].fill(LensRow::default());
                }
            }
        }
        self.set_poses(task);
        self.add_priors(task, state);
    }

    fn set_rows(&mut self, task: &Task, state: &State) {
        let held = held_columns(task, state);
        let seen = &task.problem.observations;
        let linearised = |seen: &Observation| {
            linearised(task, state, seen, &held[task.camera_of(seen)]).unwrap_or_default()
        };
        if self.lens_rows.is_empty() {
            let rows = self.rows.par_iter_mut().zip(seen).with_min_len(GRAIN);
            rows.for_each(|(row, seen)| *row = linearised(seen).0);
            return;
        }
        let rows = self.rows.par_iter_mut().zip(&mut self.lens_rows).zip(seen);
        rows.with_min_len(GRAIN)
            .for_each(|((row, lens_row), seen)| (*row, *lens_row) = linearised(seen));
    }

    fn set_points(&mut self, task: &Task) {
        let rows = &self.rows;
        let blocks = self.points.par_iter_mut().enumerate().with_min_len(GRAIN);
        blocks.for_each(|(point, block)| *block = point_block(&rows[task.index.observations_of(point)]));
    }

    fn set_poses(&mut self, task: &Task) {
        let (rows, lens_rows) = (&self.rows, &self.lens_rows);
        let blocks = self.poses.par_iter_mut().zip(&task.index.active).enumerate();
        blocks.for_each(|(active, (block, pose))| *block = pose_block(task, active, pose, rows, lens_rows));
        self.cameras.fill(CameraBlock::default());
        for (block, active) in self.poses.iter().zip(&task.index.active) {
            let camera = &mut self.cameras[task.problem.camera_of_pose[active.pose as usize] as usize];
            add(&mut camera.g, &block.lens.g);
            camera
                .h
                .iter_mut()
                .zip(&block.lens.h)
                .for_each(|(to, from)| add(to, from));
        }
    }

    fn add_priors(&mut self, task: &Task, state: &State) {
        self.ties.clear();
        for prior in &task.priors {
            let error = priors::error(prior, state);
            let weight = task.prior_loss.weight(error.norm_squared());
            if let Prior::Focal {
                camera, sigma_share, ..
            } = *prior
            {
                self.add_focal(task, state, camera as usize, weight, error.x, sigma_share);
                continue;
            }
            self.add_pose_prior(task, state, prior, weight, &error);
        }
    }

    /// The focal length is the first term of its camera where it may move.
    fn add_focal(&mut self, task: &Task, state: &State, camera: usize, weight: f64, error: f64, sigma: f64) {
        let reached = task.bounds[camera].reached(&state.cameras[camera], Term::Focal);
        if task.index.terms[camera].first() == Some(&Term::Focal) && !reached {
            self.cameras[camera].h[0][0] += weight / (sigma * sigma);
            self.cameras[camera].g[0] -= weight * error / sigma;
        }
    }

    fn add_pose_prior(
        &mut self,
        task: &Task,
        state: &State,
        prior: &Prior,
        weight: f64,
        error: &Vector6<f64>,
    ) {
        let slot = |pose: Option<u32>| pose.map_or(NONE, |pose| task.index.slot_of_pose[pose as usize]);
        let slots = index::poses_of(prior).map(slot);
        let mut slopes = priors::slopes(prior, state);
        for (slope, slot) in slopes.iter_mut().zip(slots) {
            if slot == NONE {
                continue;
            }
            if let Some(axis) = task.index.held_axis[slot as usize] {
                slope.column_mut(3 + usize::from(axis)).fill(0.0);
            }
            let block = &mut self.poses[task.index.active_of_slot[slot as usize] as usize];
            let (h, g) = (slope.tr_mul(slope) * weight, slope.tr_mul(error) * weight);
            for row in 0..POSE_TERMS {
                block.g[row] -= g[row];
                for column in 0..POSE_TERMS {
                    block.h[row][column] += h[(row, column)];
                }
            }
        }
        if slots.iter().all(|&slot| slot != NONE) {
            self.ties.push(Tie {
                slots: slots.map(|slot| slot as usize),
                h: slopes[0].tr_mul(&slopes[1]) * weight,
            });
        }
    }
}

/// Returns the columns of each lens whose term lies on its bound.
fn held_columns(task: &Task, state: &State) -> Vec<Vec<usize>> {
    let held = |(camera, terms): (usize, &Vec<Term>)| {
        let reached = |term: &Term| task.bounds[camera].reached(&state.cameras[camera], *term);
        (0..terms.len())
            .filter(|&column| reached(&terms[column]))
            .collect()
    };
    task.index.terms.iter().enumerate().map(held).collect()
}

/// Returns the rows of one observation; `None` where it has no projection: no pull.
#[inline]
fn linearised(task: &Task, state: &State, seen: &Observation, held: &[usize]) -> Option<(Row, LensRow)> {
    let terms = &task.index.terms[task.camera_of(seen)];
    let camera = &state.cameras[task.camera_of(seen)];
    let view = &state.views[seen.pose as usize];
    let sight = sight(view, camera, &state.points[seen.point as usize])?;
    let error = sight.error(camera, &seen.pixel);
    let weight = task.loss.weight(near(error)?).sqrt();
    let mut lens_row = sight.lens_row(camera, terms, weight);
    for row in &mut lens_row {
        held.iter().for_each(|&column| row[column] = 0.0);
    }
    Some((sight.row(view, camera, error, weight), lens_row))
}

/// Returns the derivatives by turn and centre of a pose, the held coordinate's zero.
#[inline]
pub(super) fn pose_columns(row: &Row, held_axis: Option<u8>) -> [[f64; POSE_TERMS]; 2] {
    let mut columns = [0, 1].map(|k| {
        let ([a, b, c], [x, y, z]) = (row.turn[k], row.point[k]);
        [a, b, c, -x, -y, -z]
    });
    if let Some(axis) = held_axis {
        columns
            .iter_mut()
            .for_each(|columns| columns[3 + usize::from(axis).min(2)] = 0.0);
    }
    columns
}

fn point_block(rows: &[Row]) -> PointBlock {
    let mut block = PointBlock::default();
    for row in rows {
        for ([x, y, z], error) in row.point.iter().zip(row.error) {
            add(&mut block.h, &[x * x, y * x, y * y, z * x, z * y, z * z]);
            add(&mut block.g, &[-x * error, -y * error, -z * error]);
        }
    }
    if is_singular(&block.h) {
        return PointBlock::default();
    }
    block.determined = Determined::Yes;
    block
}

fn is_singular(h: &[f64; 6]) -> bool {
    match super::schur::factor(h) {
        Some([xx, _, yy, _, _, zz]) => {
            xx * xx < f64::MIN_POSITIVE || yy * yy < SINGULAR * h[2] || zz * zz < SINGULAR * h[5]
        }
        None => true,
    }
}

fn pose_block(task: &Task, active: usize, pose: &Active, rows: &[Row], lens_rows: &[LensRow]) -> PoseBlock {
    let mut block = PoseBlock::default();
    let held_axis = task.index.held_axis.get(pose.slot as usize).copied().flatten();
    let camera = task.problem.camera_of_pose[pose.pose as usize] as usize;
    let terms = task.index.terms[camera].len();
    for &observation in task.index.observations_of_active.of(active) {
        let row = &rows[observation as usize];
        let columns = pose_columns(row, held_axis);
        if pose.slot != NONE {
            add_products(&mut block.h, &columns, &columns);
            add_pull(&mut block.g, &columns, &row.error);
        }
        if terms == 0 {
            continue;
        }
        let lens_row = &lens_rows[observation as usize];
        add_products(&mut block.lens.h[..terms], lens_row, lens_row);
        add_pull(&mut block.lens.g, lens_row, &row.error);
        if pose.slot != NONE {
            add_products(&mut block.mixed[..terms], lens_row, &columns);
        }
    }
    block
}

/// to += leftᵀ right, of the first rows.
#[inline]
fn add_products<const R: usize, const C: usize>(
    to: &mut [[f64; C]],
    left: &[[f64; R]; 2],
    right: &[[f64; C]; 2],
) {
    for (row, to) in to.iter_mut().enumerate().take(R) {
        let (first, second) = (left[0][row], left[1][row]);
        for (column, to) in to.iter_mut().enumerate() {
            *to += first * right[0][column] + second * right[1][column];
        }
    }
}

/// g -= Jᵀ r.
#[inline]
fn add_pull<const N: usize>(g: &mut [f64; N], columns: &[[f64; N]; 2], error: &[f64; 2]) {
    for (term, g) in g.iter_mut().enumerate() {
        *g -= columns[0][term] * error[0] + columns[1][term] * error[1];
    }
}

#[inline]
fn add<const N: usize>(to: &mut [f64; N], from: &[f64; N]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
}

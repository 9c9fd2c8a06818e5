//! The normal equations at one state: JᵀJ and -Jᵀr, by point, pose and camera, without damping.

use nalgebra::{Matrix6, Vector6};
use rayon::prelude::*;

use super::index::{ActivePose, NONE, POSE_PARAMS};
use super::objective::{Objective, squared_length};
use super::problem::{Observation, Prior};
use super::residual::{CAMERA_PARAMS, CameraJacobian, CameraParam, ResidualBlock, project};
use super::state::State;
use super::{cholesky3, index, priors};

/// Smallest number of items for a thread.
pub(super) const GRAIN: usize = 1024;

/// A pivot this much below its diagonal is only rounding: the parallax of the point is below 1e-7 rad.
const SINGULAR: f64 = 1e-14;

/// Normal equations of one point. Zero if it is held.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PointBlock {
    /// xx, yx, yy, zx, zy, zz.
    pub h: [f64; 6],
    pub g: [f64; 3],
    /// Whether the observations determine the point.
    pub is_determined: bool,
}

/// Normal equations of one pose, its contribution to those of its camera, and their off-diagonal block.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PoseBlock {
    pub h: [[f64; POSE_PARAMS]; POSE_PARAMS],
    pub g: [f64; POSE_PARAMS],
    /// Rows of the camera, columns of the pose.
    pub mixed: [[f64; POSE_PARAMS]; CAMERA_PARAMS],
    pub camera: CameraBlock,
}

/// Normal equations of one camera.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct CameraBlock {
    pub h: [[f64; CAMERA_PARAMS]; CAMERA_PARAMS],
    pub g: [f64; CAMERA_PARAMS],
}

/// The off-diagonal block of a prior between two free poses.
#[derive(Debug, Clone, Copy)]
pub(super) struct CrossBlock {
    pub slots: [usize; 2],
    /// JᵀJ, rows of the first, columns of the second.
    pub h: Matrix6<f64>,
}

/// All normal equations and the rows they were summed from.
#[derive(Debug, Default)]
pub(super) struct NormalEquations {
    pub rows: Vec<ResidualBlock>,
    /// Empty if no camera has free parameters.
    pub camera_jacobians: Vec<CameraJacobian>,
    pub points: Vec<PointBlock>,
    /// Of the active poses ([`ActivePose`]).
    pub poses: Vec<PoseBlock>,
    pub cameras: Vec<CameraBlock>,
    pub cross_blocks: Vec<CrossBlock>,
}

impl NormalEquations {
    pub(super) fn new(objective: &Objective) -> Self {
        let observations = objective.problem.observations.len();
        let camera_jacobians = if objective.index.camera_unknowns == 0 {
            0
        } else {
            observations
        };
        Self {
            rows: vec![ResidualBlock::default(); observations],
            camera_jacobians: vec![CameraJacobian::default(); camera_jacobians],
            points: vec![PointBlock::default(); objective.problem.points.len()],
            poses: vec![PoseBlock::default(); objective.index.active.len()],
            cameras: vec![CameraBlock::default(); objective.problem.cameras.len()],
            cross_blocks: Vec::new(),
        }
    }

    /// Recomputes everything at a state.
    pub(super) fn linearise(&mut self, objective: &Objective, state: &State) {
        self.set_rows(objective, state);
        self.set_points(objective);
        self.set_poses(objective);
        self.add_priors(objective, state);
    }

    /// Recomputes everything at a state, without the observations of points that they do not determine.
    pub(super) fn linearise_determined(&mut self, objective: &Objective, state: &State) {
        self.set_rows(objective, state);
        self.set_points(objective);
        for (point, block) in self.points.iter().enumerate() {
            if !block.is_determined {
                let range = objective.index.observations_of(point);
                self.rows[range.clone()].fill(ResidualBlock::default());
                if !self.camera_jacobians.is_empty() {
                    self.camera_jacobians[range].fill(CameraJacobian::default());
                }
            }
        }
        self.set_poses(objective);
        self.add_priors(objective, state);
    }

    /// Computes residual blocks and camera Jacobians of all observations.
    fn set_rows(&mut self, objective: &Objective, state: &State) {
        let held = held_columns(objective, state);
        let observations = &objective.problem.observations;
        let linearised = |observation: &Observation| {
            linearised(
                objective,
                state,
                observation,
                &held[objective.camera_of(observation)],
            )
            .unwrap_or_default()
        };
        if self.camera_jacobians.is_empty() {
            let rows = self.rows.par_iter_mut().zip(observations).with_min_len(GRAIN);
            rows.for_each(|(row, observation)| *row = linearised(observation).0);
            return;
        }
        let rows = self
            .rows
            .par_iter_mut()
            .zip(&mut self.camera_jacobians)
            .zip(observations);
        rows.with_min_len(GRAIN)
            .for_each(|((row, camera_jacobian), observation)| {
                (*row, *camera_jacobian) = linearised(observation)
            });
    }

    /// Sums the normal equations of the points.
    fn set_points(&mut self, objective: &Objective) {
        let rows = &self.rows;
        let blocks = self.points.par_iter_mut().enumerate().with_min_len(GRAIN);
        blocks.for_each(|(point, block)| *block = point_block(&rows[objective.index.observations_of(point)]));
    }

    /// Sums the normal equations of poses and cameras.
    fn set_poses(&mut self, objective: &Objective) {
        let (rows, camera_jacobians) = (&self.rows, &self.camera_jacobians);
        let blocks = self.poses.par_iter_mut().zip(&objective.index.active).enumerate();
        blocks.for_each(|(active, (block, pose))| {
            *block = pose_block(objective, active, pose, rows, camera_jacobians)
        });
        self.cameras.fill(CameraBlock::default());
        for (block, active) in self.poses.iter().zip(&objective.index.active) {
            let camera = &mut self.cameras[objective.problem.camera_of_pose[active.pose as usize] as usize];
            add(&mut camera.g, &block.camera.g);
            camera
                .h
                .iter_mut()
                .zip(&block.camera.h)
                .for_each(|(to, from)| add(to, from));
        }
    }

    /// Adds the priors.
    fn add_priors(&mut self, objective: &Objective, state: &State) {
        self.cross_blocks.clear();
        for prior in &objective.priors {
            let error = priors::error(prior, state);
            let weight = objective.prior_loss.weight(error.norm_squared());
            if let Prior::Focal {
                camera, sigma_share, ..
            } = *prior
            {
                if is_focal_free(objective, state, camera as usize) {
                    let block = &mut self.cameras[camera as usize];
                    block.h[0][0] += weight / (sigma_share * sigma_share);
                    block.g[0] -= weight * error.x / sigma_share;
                }
                continue;
            }
            self.add_pose_prior(objective, state, prior, weight, &error);
        }
    }

    /// Adds a prior on one or two poses.
    fn add_pose_prior(
        &mut self,
        objective: &Objective,
        state: &State,
        prior: &Prior,
        weight: f64,
        error: &Vector6<f64>,
    ) {
        let slot = |pose: Option<u32>| pose.map_or(NONE, |pose| objective.index.slot_of_pose[pose as usize]);
        let slots = index::poses_of(prior).map(slot);
        let mut jacobians = priors::jacobians(prior, state);
        for (jacobian, slot) in jacobians.iter_mut().zip(slots) {
            if slot == NONE {
                continue;
            }
            if let Some(axis) = objective.index.held_axis[slot as usize] {
                jacobian.column_mut(3 + usize::from(axis)).fill(0.0);
            }
            let block = &mut self.poses[objective.index.active_of_slot[slot as usize] as usize];
            let (h, g) = (
                jacobian.tr_mul(jacobian) * weight,
                jacobian.tr_mul(error) * weight,
            );
            for row in 0..POSE_PARAMS {
                block.g[row] -= g[row];
                for column in 0..POSE_PARAMS {
                    block.h[row][column] += h[(row, column)];
                }
            }
        }
        if slots.iter().all(|&slot| slot != NONE) {
            self.cross_blocks.push(CrossBlock {
                slots: slots.map(|slot| slot as usize),
                h: jacobians[0].tr_mul(&jacobians[1]) * weight,
            });
        }
    }
}

/// Whether the focal length of a camera may change. It is then the first parameter.
fn is_focal_free(objective: &Objective, state: &State, camera: usize) -> bool {
    let reached = objective.camera_bounds[camera].reached(&state.cameras[camera], CameraParam::Focal);
    objective.index.terms[camera].first() == Some(&CameraParam::Focal) && !reached
}

/// Returns for each camera the columns of parameters that lie on their bound.
fn held_columns(objective: &Objective, state: &State) -> Vec<Vec<usize>> {
    let held = |camera: usize| {
        let (bounds, camera_state) = (&objective.camera_bounds[camera], &state.cameras[camera]);
        let terms = objective.index.terms[camera].iter().enumerate();
        let reached = terms.filter(|(_, term)| bounds.reached(camera_state, **term));
        reached.map(|(column, _)| column).collect()
    };
    (0..objective.index.terms.len()).map(held).collect()
}

/// Returns the residual block and camera Jacobian of one observation. `None` if it has no projection.
#[inline]
fn linearised(
    objective: &Objective,
    state: &State,
    observation: &Observation,
    held: &[usize],
) -> Option<(ResidualBlock, CameraJacobian)> {
    let terms = &objective.index.terms[objective.camera_of(observation)];
    let camera = &state.cameras[objective.camera_of(observation)];
    let view = &state.views[observation.pose as usize];
    let projection = project(view, camera, &state.points[observation.point as usize])?;
    let error = projection.error(camera, &observation.pixel);
    let weight = objective.loss.weight(squared_length(error)?).sqrt();
    let mut camera_jacobian = projection.camera_jacobian(camera, terms, weight);
    for row in &mut camera_jacobian {
        held.iter().for_each(|&column| row[column] = 0.0);
    }
    Some((projection.row(view, camera, error, weight), camera_jacobian))
}

/// Returns the derivatives by rotation and centre of a pose, zero for a fixed coordinate.
#[inline]
pub(super) fn pose_columns(row: &ResidualBlock, held_axis: Option<u8>) -> [[f64; POSE_PARAMS]; 2] {
    let mut columns = [0, 1].map(|k| {
        let ([a, b, c], [x, y, z]) = (row.rotation[k], row.point[k]);
        [a, b, c, -x, -y, -z]
    });
    if let Some(axis) = held_axis {
        columns
            .iter_mut()
            .for_each(|columns| columns[3 + usize::from(axis).min(2)] = 0.0);
    }
    columns
}

/// Returns the normal equations of a point.
fn point_block(rows: &[ResidualBlock]) -> PointBlock {
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
    block.is_determined = true;
    block
}

/// Whether a point is not determined.
fn is_singular(h: &[f64; 6]) -> bool {
    match cholesky3::factor(h) {
        Some([xx, _, yy, _, _, zz]) => {
            xx * xx < f64::MIN_POSITIVE || yy * yy < SINGULAR * h[2] || zz * zz < SINGULAR * h[5]
        }
        None => true,
    }
}

/// Returns the normal equations of a pose.
fn pose_block(
    objective: &Objective,
    active: usize,
    pose: &ActivePose,
    rows: &[ResidualBlock],
    camera_jacobians: &[CameraJacobian],
) -> PoseBlock {
    let mut block = PoseBlock::default();
    let held_axis = objective
        .index
        .held_axis
        .get(pose.slot as usize)
        .copied()
        .flatten();
    let camera = objective.problem.camera_of_pose[pose.pose as usize] as usize;
    let terms = objective.index.terms[camera].len();
    for &observation in objective.index.observations_of_active.members(active) {
        let row = &rows[observation as usize];
        let columns = pose_columns(row, held_axis);
        if pose.slot != NONE {
            add_products(&mut block.h, &columns, &columns);
            add_gradient(&mut block.g, &columns, &row.error);
        }
        if terms == 0 {
            continue;
        }
        let camera_jacobian = &camera_jacobians[observation as usize];
        add_products(&mut block.camera.h[..terms], camera_jacobian, camera_jacobian);
        add_gradient(&mut block.camera.g, camera_jacobian, &row.error);
        if pose.slot != NONE {
            add_products(&mut block.mixed[..terms], camera_jacobian, &columns);
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
fn add_gradient<const N: usize>(g: &mut [f64; N], columns: &[[f64; N]; 2], error: &[f64; 2]) {
    for (term, g) in g.iter_mut().enumerate() {
        *g -= columns[0][term] * error[0] + columns[1][term] * error[1];
    }
}

/// to += from.
#[inline]
fn add<const N: usize>(to: &mut [f64; N], from: &[f64; N]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
}

//! Solution of the reduced system by conjugate gradients, for many photos: the matrix is never formed.
//!
//! Preconditioned by the diagonal blocks of the Schur complement (Agarwal et al. 2010, "Bundle adjustment in the
//! large"). One product costs one pass over the observations.

use rayon::prelude::*;

use super::cholesky::{self, dot};
use super::index::POSE_PARAMS;
use super::normal_equations::GRAIN;
use super::residual::CAMERA_PARAMS;
use super::schur::{ReducedSystem, damped, padded, subtract_transposed};

/// Largest number of products. An unfinished solution is still a descent direction.
const MOST_PRODUCTS: usize = 200;

/// Vectors that are reused from one solution to the next.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    residual: Vec<f64>,
    direction: Vec<f64>,
    product: Vec<f64>,
    preconditioned: Vec<f64>,
    gathered: Vec<[f64; 3]>,
}

/// A block on the diagonal: its first unknown and its Cholesky factor.
struct Block {
    at: usize,
    size: usize,
    factor: Vec<f64>,
}

/// Sets `solution` to that of the system, with a residual below `forcing` times the right side. False if the matrix
/// was not positive definite along a direction tried, or if `stop`, which is polled before each product, became true.
pub(super) fn solve(
    system: &ReducedSystem<'_>,
    forcing: f64,
    workspace: &mut Workspace,
    solution: &mut [f64],
    stop: &dyn Fn() -> bool,
) -> bool {
    let Some(blocks) = blocks(system) else {
        return false;
    };
    solution.fill(0.0);
    workspace.residual.clone_from(&system.schur.right);
    precondition(&blocks, &workspace.residual, &mut workspace.preconditioned);
    workspace.direction.clone_from(&workspace.preconditioned);
    let mut power = dot(&workspace.residual, &workspace.preconditioned);
    let enough = power * forcing * forcing;
    for _ in 0..MOST_PRODUCTS.min(2 * solution.len()) {
        // In the norm of the preconditioner: the same for any unit of any unknown.
        if power <= enough {
            break;
        }
        if stop() {
            return false;
        }
        multiply(system, workspace);
        let curvature = dot(&workspace.direction, &workspace.product);
        if curvature.is_nan() || curvature <= 0.0 {
            return false;
        }
        let length = power / curvature;
        add_scaled(solution, &workspace.direction, length);
        add_scaled(&mut workspace.residual, &workspace.product, -length);
        precondition(&blocks, &workspace.residual, &mut workspace.preconditioned);
        let next = dot(&workspace.residual, &workspace.preconditioned);
        let ratio = next / power;
        power = next;
        let both = workspace.direction.iter_mut().zip(&workspace.preconditioned);
        both.for_each(|(direction, steepest)| *direction = steepest + ratio * *direction);
    }
    true
}

/// to += factor · from.
fn add_scaled(to: &mut [f64], from: &[f64], factor: f64) {
    to.iter_mut()
        .zip(from)
        .for_each(|(to, from)| *to += from * factor);
}

/// Sets `to` to the preconditioned vector.
fn precondition(blocks: &[Block], vector: &[f64], to: &mut Vec<f64>) {
    to.clear();
    to.extend_from_slice(vector);
    for block in blocks {
        cholesky::solve(
            &block.factor,
            block.size,
            &mut to[block.at..block.at + block.size],
        );
    }
}

/// Sets `product` to the damped reduced matrix times `direction`.
fn multiply(system: &ReducedSystem<'_>, workspace: &mut Workspace) {
    let &ReducedSystem {
        objective,
        equations,
        schur,
        damping,
    } = system;
    let index = &objective.index;
    let vector = &workspace.direction;
    workspace
        .gathered
        .resize(objective.problem.points.len(), [0.0; 3]);
    let gathered = workspace.gathered.par_iter_mut().enumerate().with_min_len(GRAIN);
    gathered.for_each(|(point, gathered)| *gathered = schur.gathered(objective, point, vector));
    let gathered = &workspace.gathered;
    workspace.product.resize(vector.len(), 0.0);
    let (cameras, poses) = workspace.product.split_at_mut(index.camera_unknowns);
    multiply_cameras(system, vector, gathered, cameras);
    let slots = poses.par_chunks_mut(POSE_PARAMS).enumerate();
    slots.for_each(|(slot, to)| {
        let active = index.active_of_slot[slot] as usize;
        let block = &equations.poses[active];
        let camera = objective.problem.camera_of_pose[index.active[active].pose as usize] as usize;
        let of_camera = &vector[index.camera_at[camera]..][..index.terms[camera].len()];
        let of_pose: [f64; POSE_PARAMS] = padded(vector, index.pose_at(slot), POSE_PARAMS);
        let mut sum = [0.0; POSE_PARAMS];
        for (row, sum) in sum.iter_mut().enumerate() {
            *sum = damping_term(block.h[row][row], damping) * of_pose[row] + dot(&block.h[row], &of_pose);
        }
        for (mixed, value) in block.mixed.iter().zip(of_camera) {
            add_scaled(&mut sum, mixed, *value);
        }
        for &free in index.free_of_slot.members(slot) {
            let point = index.free_observations[free as usize].point as usize;
            subtract_transposed(
                &mut sum,
                &schur.free_observations[free as usize],
                &gathered[point],
            );
        }
        to.copy_from_slice(&sum);
    });
    for cross in &equations.cross_blocks {
        let at = cross.slots.map(|slot| index.pose_at(slot));
        for row in 0..POSE_PARAMS {
            for column in 0..POSE_PARAMS {
                let h = cross.h[(row, column)];
                workspace.product[at[0] + row] += h * vector[at[1] + column];
                workspace.product[at[1] + column] += h * vector[at[0] + row];
            }
        }
    }
}

/// Sets `to` to the rows of the cameras of the same product.
fn multiply_cameras(system: &ReducedSystem<'_>, vector: &[f64], gathered: &[[f64; 3]], to: &mut [f64]) {
    let &ReducedSystem {
        objective,
        equations,
        schur,
        damping,
    } = system;
    let index = &objective.index;
    let mut products = vec![[0.0; CAMERA_PARAMS]; index.terms.len()];
    for (camera, (product, block)) in products.iter_mut().zip(&equations.cameras).enumerate() {
        let terms = index.terms[camera].len();
        let own: [f64; CAMERA_PARAMS] = padded(vector, index.camera_at[camera], terms);
        for row in 0..terms {
            product[row] = damping_term(block.h[row][row], damping) * own[row] + dot(&block.h[row], &own);
        }
    }
    for (slot, &active) in index.active_of_slot.iter().enumerate() {
        let camera = objective.problem.camera_of_pose[index.active[active as usize].pose as usize] as usize;
        let of_pose = &vector[index.pose_at(slot)..][..POSE_PARAMS];
        let both = products[camera]
            .iter_mut()
            .zip(&equations.poses[active as usize].mixed);
        both.for_each(|(product, mixed)| *product += dot(mixed, of_pose));
    }
    for (block, point_camera) in schur.point_cameras.iter().zip(&index.point_cameras) {
        let product = &mut products[point_camera.camera as usize];
        subtract_transposed(product, block, &gathered[point_camera.point as usize]);
    }
    index.place(&products, to);
}

/// Returns the damping term of a diagonal element.
fn damping_term(h: f64, damping: f64) -> f64 {
    damped(h, damping) - h
}

/// Returns the factors of the diagonal blocks of the reduced matrix. `None` if one is not positive definite.
fn blocks(system: &ReducedSystem<'_>) -> Option<Vec<Block>> {
    let &ReducedSystem {
        objective,
        equations,
        schur,
        damping,
    } = system;
    let index = &objective.index;
    let mut cameras: Vec<_> = equations.cameras.iter().map(|block| block.h).collect();
    for (block, point_camera) in schur.point_cameras.iter().zip(&index.point_cameras) {
        subtract_square(&mut cameras[point_camera.camera as usize], block);
    }
    let cameras = cameras
        .iter()
        .zip(&equations.cameras)
        .enumerate()
        .map(|(camera, (h, block))| {
            let terms = index.terms[camera].len();
            Block::new(index.camera_at[camera], &h[..terms], &block.h, damping)
        });
    let poses: Vec<Option<Block>> = (0..index.slots)
        .into_par_iter()
        .map(|slot| {
            let block = &equations.poses[index.active_of_slot[slot] as usize];
            let mut h = block.h;
            for &free in index.free_of_slot.members(slot) {
                subtract_square(&mut h, &schur.free_observations[free as usize]);
            }
            Block::new(index.pose_at(slot), &h, &block.h, damping)
        })
        .collect();
    cameras.chain(poses).collect()
}

/// h -= U Uᵀ.
fn subtract_square<const N: usize>(h: &mut [[f64; N]; N], block: &[[f64; N]; 3]) {
    for (row, h) in h.iter_mut().enumerate() {
        subtract_transposed(h, block, &[block[0][row], block[1][row], block[2][row]]);
    }
}

impl Block {
    /// Factors `h` plus the damping that `undamped`'s diagonal gets.
    fn new<const N: usize>(
        at: usize,
        h: &[[f64; N]],
        undamped: &[[f64; N]; N],
        damping: f64,
    ) -> Option<Self> {
        let size = h.len();
        let mut factor: Vec<f64> = h.iter().flat_map(|row| row[..size].iter().copied()).collect();
        for row in 0..size {
            factor[row * size + row] += damping_term(undamped[row][row], damping);
        }
        cholesky::factor(&mut factor, size, 0.0, &|| false).then_some(Self { at, size, factor })
    }
}

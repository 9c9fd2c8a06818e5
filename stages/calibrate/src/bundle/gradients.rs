//! The reduced system by conjugate gradients, for many photos: the matrix is never formed.
//!
//! Preconditioned by the diagonal blocks of the Schur complement (Agarwal et al. 2010, "Bundle adjustment in the
//! large"). One product costs one pass over the observations.

use rayon::prelude::*;

use super::cholesky::{self, dot};
use super::index::POSE_TERMS;
use super::schur::{Schur, damped, subtract_transposed, taken};
use super::sight::LENS_TERMS;
use super::system::{GRAIN, System};
use super::task::Task;

/// Products at most; an unfinished solution is still a descent.
const MOST_PRODUCTS: usize = 200;

/// Vectors kept from one solution to the next.
#[derive(Debug, Default)]
pub(super) struct Room {
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

/// Sets `solution` to that of the damped reduced system, until the residual is below `forcing` times the right side.
/// Tells whether the matrix was positive wherever it was tried.
pub(super) fn solve(
    task: &Task,
    system: &System,
    schur: &Schur,
    damping: f64,
    forcing: f64,
    room: &mut Room,
    solution: &mut [f64],
) -> bool {
    let Some(blocks) = blocks(task, system, schur, damping) else {
        return false;
    };
    solution.fill(0.0);
    room.residual.clone_from(&schur.right);
    precondition(&blocks, &room.residual, &mut room.preconditioned);
    room.direction.clone_from(&room.preconditioned);
    let mut power = dot(&room.residual, &room.preconditioned);
    let enough = power * forcing * forcing;
    for _ in 0..MOST_PRODUCTS.min(2 * solution.len()) {
        // In the norm of the preconditioner: the same for any unit of any unknown.
        if power <= enough {
            break;
        }
        multiply(task, system, schur, damping, room);
        let curvature = dot(&room.direction, &room.product);
        if curvature.is_nan() || curvature <= 0.0 {
            return false;
        }
        let length = power / curvature;
        add_scaled(solution, &room.direction, length);
        add_scaled(&mut room.residual, &room.product, -length);
        precondition(&blocks, &room.residual, &mut room.preconditioned);
        let next = dot(&room.residual, &room.preconditioned);
        let turn = next / power;
        power = next;
        let both = room.direction.iter_mut().zip(&room.preconditioned);
        both.for_each(|(direction, steepest)| *direction = steepest + turn * *direction);
    }
    true
}

fn add_scaled(to: &mut [f64], from: &[f64], factor: f64) {
    to.iter_mut()
        .zip(from)
        .for_each(|(to, from)| *to += from * factor);
}

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
fn multiply(task: &Task, system: &System, schur: &Schur, damping: f64, room: &mut Room) {
    let index = &task.index;
    let vector = &room.direction;
    room.gathered.resize(task.problem.points.len(), [0.0; 3]);
    let gathered = room.gathered.par_iter_mut().enumerate().with_min_len(GRAIN);
    gathered.for_each(|(point, gathered)| *gathered = schur.gathered(task, point, vector));
    let gathered = &room.gathered;
    room.product.resize(vector.len(), 0.0);
    let (lenses, poses) = room.product.split_at_mut(index.camera_unknowns);
    multiply_lenses(task, system, schur, damping, vector, gathered, lenses);
    let slots = poses.par_chunks_mut(POSE_TERMS).enumerate();
    slots.for_each(|(slot, to)| {
        let active = index.active_of_slot[slot] as usize;
        let block = &system.poses[active];
        let camera = task.problem.camera_of_pose[index.active[active].pose as usize] as usize;
        let of_lens = &vector[index.camera_at[camera]..][..index.terms[camera].len()];
        let of_pose: [f64; POSE_TERMS] = taken(vector, index.pose_at(slot), POSE_TERMS);
        let mut sum = [0.0; POSE_TERMS];
        for (row, sum) in sum.iter_mut().enumerate() {
            *sum = extra(block.h[row][row], damping) * of_pose[row] + dot(&block.h[row], &of_pose);
        }
        for (mixed, value) in block.mixed.iter().zip(of_lens) {
            add_scaled(&mut sum, mixed, *value);
        }
        for &link in index.links_of_slot.of(slot) {
            let point = index.links[link as usize].point as usize;
            subtract_transposed(&mut sum, &schur.links[link as usize], &gathered[point]);
        }
        to.copy_from_slice(&sum);
    });
    for tie in &system.ties {
        let at = tie.slots.map(|slot| index.pose_at(slot));
        for row in 0..POSE_TERMS {
            for column in 0..POSE_TERMS {
                let h = tie.h[(row, column)];
                room.product[at[0] + row] += h * vector[at[1] + column];
                room.product[at[1] + column] += h * vector[at[0] + row];
            }
        }
    }
}

fn multiply_lenses(
    task: &Task,
    system: &System,
    schur: &Schur,
    damping: f64,
    vector: &[f64],
    gathered: &[[f64; 3]],
    to: &mut [f64],
) {
    let index = &task.index;
    let mut products = vec![[0.0; LENS_TERMS]; index.terms.len()];
    for (camera, (product, block)) in products.iter_mut().zip(&system.cameras).enumerate() {
        let terms = index.terms[camera].len();
        let own: [f64; LENS_TERMS] = taken(vector, index.camera_at[camera], terms);
        for row in 0..terms {
            product[row] = extra(block.h[row][row], damping) * own[row] + dot(&block.h[row], &own);
        }
    }
    for (slot, &active) in index.active_of_slot.iter().enumerate() {
        let camera = task.problem.camera_of_pose[index.active[active as usize].pose as usize] as usize;
        let of_pose = &vector[index.pose_at(slot)..][..POSE_TERMS];
        let both = products[camera]
            .iter_mut()
            .zip(&system.poses[active as usize].mixed);
        both.for_each(|(product, mixed)| *product += dot(mixed, of_pose));
    }
    for (block, couple) in schur.couples.iter().zip(&index.couples) {
        let product = &mut products[couple.camera as usize];
        subtract_transposed(product, block, &gathered[couple.point as usize]);
    }
    index.place(&products, to);
}

/// What damping adds to a diagonal element.
fn extra(h: f64, damping: f64) -> f64 {
    damped(h, damping) - h
}

/// Returns the factors of the diagonal blocks of the reduced matrix, `None` if one is not positive.
fn blocks(task: &Task, system: &System, schur: &Schur, damping: f64) -> Option<Vec<Block>> {
    let index = &task.index;
    let mut lenses: Vec<_> = system.cameras.iter().map(|block| block.h).collect();
    for (block, couple) in schur.couples.iter().zip(&index.couples) {
        subtract_square(&mut lenses[couple.camera as usize], block);
    }
    let lenses = lenses
        .iter()
        .zip(&system.cameras)
        .enumerate()
        .map(|(camera, (h, block))| {
            let terms = index.terms[camera].len();
            Block::new(index.camera_at[camera], &h[..terms], &block.h, damping)
        });
    let poses: Vec<Option<Block>> = (0..index.slots)
        .into_par_iter()
        .map(|slot| {
            let block = &system.poses[index.active_of_slot[slot] as usize];
            let mut h = block.h;
            for &link in index.links_of_slot.of(slot) {
                subtract_square(&mut h, &schur.links[link as usize]);
            }
            Block::new(index.pose_at(slot), &h, &block.h, damping)
        })
        .collect();
    lenses.chain(poses).collect()
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
            factor[row * size + row] += extra(undamped[row][row], damping);
        }
        cholesky::factor(&mut factor, size, 0.0).then_some(Self { at, size, factor })
    }
}

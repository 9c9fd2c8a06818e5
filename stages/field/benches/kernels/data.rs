//! What the kernels work on: numbers, points along rays.

use marf_field::cpu::encode::Points;
use marf_field::cpu::simd::{Block, InstructionSet, LANES, flat_mut};

/// Samples of a ray.
pub const RAY: usize = 64;

/// Samples of a run. Plain Rust calls a function for every multiply-add.
pub fn samples(level: InstructionSet) -> usize {
    if matches!(level, InstructionSet::Plain(_)) {
        1 << 13
    } else {
        1 << 16
    }
}

/// Uniform in [-1, 1].
pub fn numbers(count: usize, seed: u64) -> Vec<f32> {
    let mut state = seed;
    let draw = |_| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / 8_388_608.0 - 1.0
    };
    (0..count).map(draw).collect()
}

pub fn blocks(count: usize, seed: u64) -> Vec<Block> {
    let mut blocks = vec![Block::default(); count];
    flat_mut(&mut blocks).copy_from_slice(&numbers(count * LANES, seed));
    blocks
}

/// Points along rays through the unit box, a step of sqrt(3) / 1024 apart.
pub fn points(count: usize) -> [Vec<f32>; 3] {
    let random = numbers(count / RAY * 6, 5);
    let mut axes = [const { Vec::new() }; 3];
    for ray in random.chunks_exact(6) {
        let norm = ray[3..].iter().map(|part| part * part).sum::<f32>().sqrt();
        for step in 0..RAY {
            let t = step as f32 * 1.732 / 1024.0;
            for axis in 0..3 {
                let at = ray[axis] * 0.5 + 0.5 + ray[3 + axis] / norm * t;
                axes[axis].push(at.clamp(0.0, 1.0));
            }
        }
    }
    axes
}

pub fn whole([x, y, z]: &[Vec<f32>; 3]) -> Points<'_> {
    Points { x, y, z }
}

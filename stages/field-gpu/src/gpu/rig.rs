//! What the tests of layers and of light share: a device with the arrays of a batch, and columns of samples.

use std::sync::Arc;

use marf_shaders::faults;

use super::Gpu;
use super::array::Array;
use super::batch::{Batch, BatchSize};
use super::testing::{gpu, worst};
use marf_field::GpuError;
use marf_field::cpu::simd::{Block, LANES, flat_mut};

/// Rounding of sums of up to 1,101 terms, or 37 chunks of 128, where a driver does not fuse multiply-adds, as a share of
/// the largest number.
pub const TOLERANCE: f32 = 2e-6;
/// What arrays hold where nothing must be written.
pub const UNTOUCHED: f32 = -7.25;

/// Returns whether nothing was written over [`UNTOUCHED`].
pub fn is_untouched(value: &f32) -> bool {
    value.to_bits() == UNTOUCHED.to_bits()
}

/// Asserts that numbers agree within a share of the largest.
pub fn agree(name: &str, found: &[f32], expected: &[f32], tolerance: f32) {
    let size = expected.iter().fold(1e-30_f32, |size, x| size.max(x.abs()));
    let (error, at) = worst(found, expected);
    println!("{name}: largest error {:.1e} of the largest number", error / size);
    assert!(
        error <= tolerance * size,
        "{name}, {at}: {} against {}, {} of {size}",
        found[at],
        expected[at],
        error / size
    );
}

pub fn blocks(numbers: &[f32]) -> Vec<Block> {
    let mut blocks = vec![Block::ZERO; numbers.len().div_ceil(LANES)];
    flat_mut(&mut blocks)[..numbers.len()].copy_from_slice(numbers);
    blocks
}

/// Rows of samples `[n][width]` as columns `[width][capacity]`. `rest` where there is no sample.
pub fn columns(rows: &[f32], width: usize, capacity: usize, rest: f32) -> Vec<f32> {
    let mut columns = vec![rest; width * capacity];
    for (sample, row) in rows.chunks(width).enumerate() {
        for (at, value) in row.iter().enumerate() {
            columns[at * capacity + sample] = *value;
        }
    }
    columns
}

/// A device with the arrays that all kernels share.
pub struct Rig {
    pub gpu: Arc<Gpu>,
    pub counts: Array<u32>,
    pub faults: Array<u32>,
    pub size: BatchSize,
}

impl Rig {
    /// `None` without an adapter. `in_use`: visited and kept samples, rays.
    pub fn new(test: &str, size: BatchSize, in_use: [u32; 3]) -> Option<Self> {
        let gpu = gpu(test)?;
        let [visited, kept, started] = in_use;
        let made = |gpu: &Gpu| -> Result<_, GpuError> {
            let counts = gpu.filled("counts", &[visited, kept, started, 0])?;
            Ok((counts, gpu.zeros("faults", faults::LEN)?))
        };
        let (counts, faults) = made(&gpu).unwrap();
        Some(Self {
            gpu,
            counts,
            faults,
            size,
        })
    }

    pub fn batch(&self) -> Batch<'_> {
        Batch {
            gpu: &self.gpu,
            counts: &self.counts,
            faults: &self.faults,
            capacity: self.size.samples,
            rays: self.size.rays,
        }
    }

    pub fn filled(&self, values: &[f32]) -> Array<f32> {
        self.gpu.filled("numbers", values).unwrap()
    }

    pub fn untouched(&self, rows: usize) -> Array<f32> {
        self.filled(&vec![UNTOUCHED; rows * self.size.samples])
    }

    /// Places of the faults that are set.
    pub fn faulty(&self) -> Vec<u32> {
        let faults = self.gpu.read(&self.faults).unwrap();
        let set = (0..).zip(faults).filter(|(_, fault)| *fault > 0);
        set.map(|(place, _)| place).collect()
    }
}

//! What a training keeps on a device, and how many bytes that is before any of it is there.

use marf_shaders::{Observed, Step};

use super::Gpu;
use super::array::Array;
use super::arrays::Arrays;
use super::batch::BatchSize;
use super::forward::{Lanes, Purpose, check_columns};
use super::occupancy;
use super::rays::Photos;
use super::tables::Grid;
use super::weights::DeviceWeights;
use marf_field::training::Training;
use marf_field::{FieldError, GpuError};

/// Sample slots a sample of the batch: rays visit more samples than they train.
const VISITED: usize = 2;
/// Slots come in multiples of this.
const SLOTS: usize = 256;
/// Storage buffers that a kernel of a training binds at most. Core WebGPU has 8 a stage, every card 16 and
/// more.
const STORAGE_BUFFERS: u64 = 11;
/// Memory is requested in pieces of at most this many bytes.
const PIECE: u64 = 1 << 30;

/// The arrays of a training on a device.
pub struct DeviceState {
    pub grid: Grid,
    pub weights: DeviceWeights,
    pub average: DeviceWeights,
    pub lanes: Lanes,
    pub arrays: Arrays,
    pub photos: Photos,
    pub observations: Array<Observed>,
    pub step: Array<Step>,
    pub occupancy: occupancy::State,
}

impl DeviceState {
    /// Takes the memory of a training, once it is known that the device has as much.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] before anything is allocated. [`GpuError::Limit`] where one array exceeds a
    /// binding or a buffer.
    pub fn new(gpu: &Gpu, training: &Training) -> Result<Self, FieldError> {
        let offered = u64::from(gpu.limits.max_storage_buffers_per_shader_stage);
        if offered < STORAGE_BUFFERS {
            let limit = "max_storage_buffers_per_shader_stage";
            let hint = "it renders, and does not train: use `device = \"cpu\"`";
            return Err(gpu.limit(limit, offered, STORAGE_BUFFERS, hint).into());
        }
        let needed = MemoryNeed::count(gpu, training)?;
        let offered = gpu.offered(needed.bytes)?;
        if offered < needed.bytes {
            return Err(needed.refused(gpu, offered).into());
        }
        Self::made(gpu, training)
    }

    fn made(gpu: &Gpu, training: &Training) -> Result<Self, FieldError> {
        let (config, state) = (&training.config, &training.state);
        let rays = (config.batch_samples as usize).next_multiple_of(SLOTS);
        let size = BatchSize {
            samples: VISITED * rays,
            rays,
        };
        check_columns(gpu, &state.weights, size, Purpose::Training)?;
        let grid = Grid::new(gpu, &state.weights.shapes, state.weights.features)?;
        let weights = DeviceWeights::new(gpu, &grid, &state.weights)?;
        let average = DeviceWeights::new(gpu, &grid, &state.average)?;
        let most_steps = training.sizes.steps(config, training.sizes.halvings.value);
        let lanes = Lanes::new(gpu, &weights, size, &most_steps)?;
        let arrays = Arrays::new(gpu, &grid, &weights, &lanes, training)?;
        let photos = Photos::new(gpu, &training.views, &training.world_from_cams, &training.frame)?;
        let seen = training.observations.len();
        let hint = "set `depth_weight = 0`, so that sparse points do not pull";
        gpu.check_binding((seen * size_of::<Observed>()) as u64, hint)?;
        Ok(Self {
            observations: gpu.zeros("observations", seen)?,
            step: gpu.uniform("step", bytemuck::Zeroable::zeroed())?,
            occupancy: occupancy::State::new(gpu, &state.occupancy)?,
            grid,
            weights,
            average,
            lanes,
            arrays,
            photos,
        })
    }

    /// Returns the bytes of all that has the size of the tables.
    fn table_bytes(&self) -> u64 {
        let moments = &self.arrays.tables;
        let arrays = [
            &self.weights.tables,
            &self.average.tables,
            &moments.mean,
            &moments.square,
        ];
        let numbers = arrays.iter().map(|array| array.bytes()).sum::<u64>();
        numbers + moments.count.bytes() + self.arrays.gradient.bytes()
    }
}

/// The memory of a training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryNeed {
    /// All of it.
    pub bytes: u64,
    /// Tables, their average, moments and gradient: what `log2_table` decides.
    pub tables: u64,
    /// Photos: what `memory` decides. The rest is decided by `batch_samples`.
    pub photos: u64,
}

impl MemoryNeed {
    /// Counts the arrays of a training without taking any memory.
    ///
    /// The same code makes them later, so the sum is exact except for uniforms that are made when kernels are
    /// bound.
    ///
    /// # Errors
    /// [`GpuError::Limit`] where one array exceeds a binding or a buffer.
    pub fn count(gpu: &Gpu, training: &Training) -> Result<Self, FieldError> {
        let counting = gpu.counting()?;
        let held = DeviceState::made(&counting, training)?;
        Ok(Self {
            bytes: counting.taken(),
            tables: held.table_bytes(),
            photos: held.photos.pixels.bytes(),
        })
    }

    /// Returns the refusal of a device that offers less, with the key to lower: that of the largest share.
    fn refused(self, gpu: &Gpu, offered: u64) -> GpuError {
        let batch = self.bytes - self.tables - self.photos;
        let shares = [
            (self.photos, "photos", "memory"),
            (batch, "samples of a step", "batch_samples"),
            (self.tables, "tables", "log2_table"),
        ];
        let largest = shares.into_iter().max_by_key(|share| share.0);
        let (share, part, key) = largest.unwrap_or(shares[1]);
        GpuError::TooLarge {
            adapter: gpu.name().to_owned(),
            offered,
            needed: self.bytes,
            share,
            part,
            key,
        }
    }
}

impl Gpu {
    /// Returns how many of `bytes` the device gives: they are allocated and freed.
    fn offered(&self, bytes: u64) -> Result<u64, GpuError> {
        #[cfg(test)]
        if let Some(planted) = self.planted_memory {
            return Ok(bytes.min(planted));
        }
        let most = PIECE.min(self.limits.max_buffer_size);
        let (mut pieces, mut given) = (Vec::new(), 0);
        while given < bytes {
            let piece = (bytes - given).min(most);
            match self.buffer("memory of a training", piece, wgpu::BufferUsages::STORAGE) {
                Ok(buffer) => pieces.push(buffer),
                Err(GpuError::Memory { .. }) => break,
                Err(error) => return Err(error),
            }
            given += piece;
        }
        for piece in pieces {
            piece.destroy();
        }
        // What is destroyed is given back when the device is looked at next.
        self.wait()?;
        Ok(given)
    }
}

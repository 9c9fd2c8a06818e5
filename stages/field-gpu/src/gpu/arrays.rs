//! Arrays of a training on a device in addition to the weights and the batch.

use marf_shaders::{LevelScale, Pace, Rates, Rescaling, SpreadRun, Total, found};

use super::Gpu;
use super::array::Array;
use super::exposures::ExposureArrays;
use super::forward::Lanes;
use super::light::{RING, weights_of_losses};
use super::nets::Nets;
use super::tables::{Grid, Rise, rescaling, start_scales};
use super::weights::DeviceWeights;
use marf_field::GpuError;
use marf_field::cpu::adam::Moments;
use marf_field::training::Training;
use marf_field::weights::NET_ROW;

/// First and second moments of a tensor, and the steps of its rows.
pub struct DeviceMoments {
    /// f32 `[rows][row]`.
    pub mean: Array<f32>,
    /// As `mean`.
    pub square: Array<f32>,
    /// `[rows]`.
    pub count: Array<u32>,
}

impl DeviceMoments {
    fn new(gpu: &Gpu, numbers: usize, row: usize) -> Result<Self, GpuError> {
        Ok(Self {
            mean: gpu.zeros("mean of gradients", numbers)?,
            square: gpu.zeros("square of gradients", numbers)?,
            count: gpu.zeros("steps of rows", numbers / row)?,
        })
    }

    /// Overwrites them.
    pub fn write(&self, gpu: &Gpu, moments: &Moments) {
        gpu.write(&self.mean, 0, &moments.first);
        gpu.write(&self.square, 0, &moments.second);
        gpu.write(&self.count, 0, &moments.count);
    }
}

/// Arrays of a training that pictures do without.
pub struct Arrays {
    /// Moments of networks and background.
    pub nets: DeviceMoments,
    /// Gradient of networks and background.
    pub nets_gradient: Array<f32>,
    /// f32 `[found::LEN][rays]`.
    pub found: Array<f32>,
    /// Slopes in logits and raw density of kept samples, f32 `[4][capacity]`.
    pub d_outputs: Array<f32>,
    /// Slopes of the features of kept samples, f32 `[inputs][capacity]`.
    pub slopes: Array<f32>,
    /// Parts of gradients, and what the way back keeps of a tile.
    pub work: Array<f32>,
    /// Moments of all tables.
    pub tables: DeviceMoments,
    /// Gradient of all tables, in fixed point.
    pub gradient: Array<i32>,
    /// Fixed point of every level.
    pub scales: Array<LevelScale>,
    /// What they follow.
    pub rescaling: Array<Rescaling>,
    /// Corrections of Adam by step count.
    pub bias: Array<[f32; 2]>,
    /// Exposures of the photos.
    pub exposures: ExposureArrays,
    /// Step size of the networks, and the place in `ring`.
    pub pace: Array<Pace>,
    /// Step size of the tables, and what their averages keep.
    pub rates: Array<Rates>,
    /// What the losses weigh.
    pub losses: Array<SpreadRun>,
    /// Totals of the last steps, read by the host.
    pub ring: Array<Total>,
}

impl Arrays {
    /// Allocates the arrays.
    ///
    /// # Errors
    /// More than the device holds.
    pub fn new(
        gpu: &Gpu,
        grid: &Grid,
        weights: &DeviceWeights,
        lanes: &Lanes,
        training: &Training,
    ) -> Result<Self, GpuError> {
        let (capacity, rays) = (lanes.capacity, lanes.rays.slots);
        let (views, gain) = (training.views.len(), training.config.gain);
        let layers = &weights.layers;
        let inputs = layers.shapes.first().map_or(0, |[inputs, _]| *inputs);
        Ok(Self {
            nets: DeviceMoments::new(gpu, layers.numbers(), NET_ROW)?,
            nets_gradient: gpu.zeros("gradient of the networks", layers.numbers())?,
            found: gpu.zeros("losses of rays", found::LEN * rays)?,
            d_outputs: gpu.zeros("slopes of outputs", 4 * capacity)?,
            slopes: gpu.zeros("slopes of features", inputs * capacity)?,
            work: gpu.zeros("work of the networks", layers.work(capacity, rays))?,
            tables: DeviceMoments::new(gpu, grid.numbers(), grid.features())?,
            gradient: gpu.zeros("gradient of the tables", grid.numbers())?,
            scales: gpu.filled("scales", &start_scales(grid))?,
            rescaling: gpu.uniform("rescaling", rescaling(grid, Rise::Slow))?,
            bias: Nets::bias(gpu, &training.bias)?,
            exposures: ExposureArrays::new(gpu, views, gain, rays, found::GAIN)?,
            pace: gpu.uniform("pace", Pace::default())?,
            rates: gpu.uniform("rates", bytemuck::Zeroable::zeroed())?,
            losses: gpu.uniform("losses", bytemuck::Zeroable::zeroed())?,
            ring: gpu.zeros("totals", RING)?,
        })
    }

    /// Writes how far scales may rise from now on.
    pub fn write_rise(&self, gpu: &Gpu, grid: &Grid, rise: Rise) {
        gpu.write(&self.rescaling, 0, &[rescaling(grid, rise)]);
    }

    /// Writes what `spread` needs of a step.
    pub fn write_losses(&self, gpu: &Gpu, lanes: &Lanes, training: &Training, step: u64) {
        let losses = weights_of_losses(lanes.batch(gpu), training, step);
        gpu.write(&self.losses, 0, &[losses]);
    }

    /// Overwrites the moments of layers and background, which come in the order of `Weights::tensors` behind the tables.
    pub fn write_net_moments(&self, gpu: &Gpu, tensors: &[Moments]) {
        let mut first = 0;
        for moments in tensors {
            gpu.write(&self.nets.mean, first, &moments.first);
            gpu.write(&self.nets.square, first, &moments.second);
            gpu.write(&self.nets.count, first / NET_ROW, &moments.count);
            first += moments.first.len();
        }
    }

    /// Copies the moments of layers and background back.
    ///
    /// # Errors
    /// A lost device.
    pub fn read_net_moments(&self, gpu: &Gpu, tensors: &mut [Moments]) -> Result<(), GpuError> {
        let (mean, square) = (gpu.read(&self.nets.mean)?, gpu.read(&self.nets.square)?);
        let count = gpu.read(&self.nets.count)?;
        let mut first = 0;
        for moments in tensors {
            let (numbers, rows) = (moments.first.len(), moments.count.len());
            moments.first.copy_from_slice(&mean[first..][..numbers]);
            moments.second.copy_from_slice(&square[first..][..numbers]);
            moments.count.copy_from_slice(&count[first / NET_ROW..][..rows]);
            first += numbers;
        }
        Ok(())
    }

    /// Overwrites the moments of all tables.
    pub fn write_table_moments(&self, gpu: &Gpu, grid: &Grid, levels: &[Moments]) {
        let joined = |of: &dyn Fn(&Moments) -> Vec<f32>| {
            grid.join(&levels.iter().map(of).collect::<Vec<_>>(), grid.features())
        };
        let counts: Vec<Vec<u32>> = levels.iter().map(|level| level.count.clone()).collect();
        self.tables.write(
            gpu,
            &Moments {
                first: joined(&|level| level.first.clone()),
                second: joined(&|level| level.second.clone()),
                count: grid.join(&counts, 1),
            },
        );
    }

    /// Copies the moments of all tables back.
    ///
    /// # Errors
    /// A lost device.
    pub fn read_table_moments(&self, gpu: &Gpu, grid: &Grid, levels: &mut [Moments]) -> Result<(), GpuError> {
        let first = grid.split(&gpu.read(&self.tables.mean)?, grid.features());
        let second = grid.split(&gpu.read(&self.tables.square)?, grid.features());
        let count = grid.split(&gpu.read(&self.tables.count)?, 1);
        for (((level, first), second), count) in levels.iter_mut().zip(first).zip(second).zip(count) {
            *level = Moments { first, second, count };
        }
        Ok(())
    }

    /// Sets the gradient of the tables to zero.
    pub fn clear_gradient(&self, gpu: &Gpu) {
        gpu.write(&self.gradient, 0, &vec![0; self.gradient.len()]);
    }
}

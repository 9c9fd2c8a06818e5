//! What a training keeps on a device beside the weights and the batch.

use marf_shaders::{Blending, LevelScale, Pace, Rates, Rescaling, SpreadRun, Total, found};

use super::Gpu;
use super::array::Array;
use super::exposures::ExposureArrays;
use super::forward::Lanes;
use super::light::{RING, weights_of_losses};
use super::nets::{Gradient, Nets};
use super::tables::{Grid, Rise, rescaling, start_scales};
use super::weights::{BACKGROUND, DeviceLayer, DeviceWeights};
use crate::cpu::adam::{Bias, Moments};
use crate::cpu::march::Steps;
use crate::weights::NET_ROW;
use crate::{Config, Gain, GpuError};

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

    /// Copies back as many as `moments` holds.
    ///
    /// # Errors
    /// A lost device.
    pub fn read(&self, gpu: &Gpu, moments: &mut Moments) -> Result<(), GpuError> {
        let (numbers, rows) = (moments.first.len(), moments.count.len());
        moments.first.copy_from_slice(&gpu.read(&self.mean)?[..numbers]);
        moments
            .second
            .copy_from_slice(&gpu.read(&self.square)?[..numbers]);
        moments.count.copy_from_slice(&gpu.read(&self.count)?[..rows]);
        Ok(())
    }
}

/// What a layer needs on the way back.
pub struct Learnt {
    /// f32 `[outputs][inputs]`.
    pub turned: Array<f32>,
    /// f32 `[inputs][outputs]`.
    pub gradient: Array<f32>,
    /// Of its weights.
    pub moments: DeviceMoments,
    /// Slope of its input.
    pub slope: Array<f32>,
}

impl Learnt {
    fn new(gpu: &Gpu, layer: &DeviceLayer, capacity: usize) -> Result<Self, GpuError> {
        let numbers = layer.inputs * layer.outputs;
        Ok(Self {
            turned: gpu.zeros("turned weights", numbers)?,
            gradient: gpu.zeros("gradient of a layer", numbers)?,
            moments: DeviceMoments::new(gpu, numbers, NET_ROW)?,
            slope: gpu.zeros("slope of a layer", layer.inputs * capacity)?,
        })
    }
}

/// Arrays of a training that pictures do without.
pub struct Arrays {
    /// Layers of the density network.
    pub density: Vec<Learnt>,
    /// Layers of the colour network.
    pub color: Vec<Learnt>,
    /// Moments of the background.
    pub background: DeviceMoments,
    /// f32 `[4][16]`.
    pub background_gradient: Array<f32>,
    /// f32 `[16][rays]`.
    pub harmonics: Array<f32>,
    /// f32 `[found::LEN][rays]`.
    pub found: Array<f32>,
    /// f32 `[16][capacity]`; rows from 3 on stay 0.
    pub d_logits: Array<f32>,
    /// Parts of the gradient of one layer, one layer after the other.
    pub parts: Array<f32>,
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
    /// Step size of the tables.
    pub rates: Array<Rates>,
    /// What the averages keep.
    pub blending: Array<Blending>,
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
        (views, gain): (usize, Gain),
        bias: &Bias,
    ) -> Result<Self, GpuError> {
        let (capacity, rays) = (lanes.capacity, lanes.rays.slots);
        let learnt = |layers: &[DeviceLayer]| {
            let layers = layers.iter().map(|layer| Learnt::new(gpu, layer, capacity));
            layers.collect::<Result<Vec<_>, _>>()
        };
        let all = weights.density.iter().chain(&weights.color);
        let parts = all.map(|layer| Gradient::parts(capacity, layer.shape())).max();
        let behind = Gradient::parts(rays, [4, NET_ROW]);
        Ok(Self {
            density: learnt(&weights.density)?,
            color: learnt(&weights.color)?,
            background: DeviceMoments::new(gpu, BACKGROUND, NET_ROW)?,
            background_gradient: gpu.zeros("gradient of the background", BACKGROUND)?,
            harmonics: gpu.zeros("harmonics of rays", NET_ROW * rays)?,
            found: gpu.zeros("losses of rays", found::LEN * rays)?,
            d_logits: gpu.zeros("slopes of logits", 16 * capacity)?,
            parts: gpu.zeros("parts of gradients", parts.unwrap_or(0).max(behind))?,
            tables: DeviceMoments::new(gpu, grid.numbers(), grid.features())?,
            gradient: gpu.zeros("gradient of the tables", grid.numbers())?,
            scales: gpu.filled("scales", &start_scales(grid))?,
            rescaling: gpu.uniform("rescaling", rescaling(grid, Rise::Slow))?,
            bias: Nets::bias(gpu, bias)?,
            exposures: ExposureArrays::new(gpu, views, gain, rays, found::GAIN)?,
            pace: gpu.uniform("pace", Pace::default())?,
            rates: gpu.uniform("rates", bytemuck::Zeroable::zeroed())?,
            blending: gpu.uniform("blending", bytemuck::Zeroable::zeroed())?,
            losses: gpu.uniform("losses", bytemuck::Zeroable::zeroed())?,
            ring: gpu.zeros("totals", RING)?,
        })
    }

    /// Writes how far scales may rise from now on.
    pub fn write_rise(&self, gpu: &Gpu, grid: &Grid, rise: Rise) {
        gpu.write(&self.rescaling, 0, &[rescaling(grid, rise)]);
    }

    /// Writes what `spread` needs of the steps along rays.
    pub fn write_losses(&self, gpu: &Gpu, lanes: &Lanes, config: &Config, steps: &Steps) {
        gpu.write(
            &self.losses,
            0,
            &[weights_of_losses(lanes.batch(gpu), config, steps)],
        );
    }

    /// Returns the moments of layers and background, in the order of `Weights::tensors` behind the tables.
    pub fn net_moments(&self) -> Vec<&DeviceMoments> {
        let layers = self.density.iter().chain(&self.color);
        layers
            .map(|layer| &layer.moments)
            .chain([&self.background])
            .collect()
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

//! The trained numbers of a field on a device.

use super::Gpu;
use super::array::Array;
use super::tables::Grid;
use crate::GpuError;
use crate::cpu::net::{Layer, Net};
use crate::cpu::simd::{flat, flat_mut};
use crate::weights::{NET_ROW, Weights};

/// Numbers of the background on a device: one row more than channels, so that sums take 4 rows at once.
pub const BACKGROUND: usize = 4 * NET_ROW;

/// One layer.
pub struct DeviceLayer {
    /// Width of the input.
    pub inputs: usize,
    /// Width of the output.
    pub outputs: usize,
    /// f32 `[inputs][outputs]`.
    pub weights: Array<f32>,
}

impl DeviceLayer {
    /// Returns `[inputs, outputs]`.
    pub fn shape(&self) -> [usize; 2] {
        [self.inputs, self.outputs]
    }

    fn new(gpu: &Gpu, layer: &Layer) -> Result<Self, GpuError> {
        Ok(Self {
            inputs: layer.inputs,
            outputs: layer.outputs,
            weights: gpu.filled("weights of a layer", flat(&layer.weights))?,
        })
    }
}

/// Tables, networks and background.
pub struct DeviceWeights {
    /// f32 `[entries, F]`.
    pub tables: Array<f32>,
    /// The density network.
    pub density: Vec<DeviceLayer>,
    /// The colour network.
    pub color: Vec<DeviceLayer>,
    /// f32 `[4][16]`; the last row is unused.
    pub background: Array<f32>,
}

impl DeviceWeights {
    /// Copies weights to a device.
    ///
    /// # Errors
    /// More than the device holds.
    pub fn new(gpu: &Gpu, grid: &Grid, weights: &Weights) -> Result<Self, GpuError> {
        let layers = |net: &Net| {
            let layers = net.layers.iter().map(|layer| DeviceLayer::new(gpu, layer));
            layers.collect::<Result<Vec<_>, _>>()
        };
        let new = Self {
            tables: gpu.zeros("tables", grid.numbers())?,
            density: layers(&weights.density)?,
            color: layers(&weights.color)?,
            background: gpu.zeros("background", BACKGROUND)?,
        };
        new.write(gpu, grid, weights);
        Ok(new)
    }

    /// Overwrites them.
    pub fn write(&self, gpu: &Gpu, grid: &Grid, weights: &Weights) {
        gpu.write(&self.tables, 0, &grid.join(&weights.tables, weights.features));
        let layers = self.density.iter().zip(&weights.density.layers);
        for (array, layer) in layers.chain(self.color.iter().zip(&weights.color.layers)) {
            gpu.write(&array.weights, 0, flat(&layer.weights));
        }
        gpu.write(&self.background, 0, &weights.background);
    }

    /// Copies them back.
    ///
    /// # Errors
    /// A lost device.
    pub fn read(&self, gpu: &Gpu, grid: &Grid, weights: &mut Weights) -> Result<(), GpuError> {
        weights.tables = grid.split(&gpu.read(&self.tables)?, weights.features);
        let layers = self.density.iter().zip(&mut weights.density.layers);
        for (array, layer) in layers.chain(self.color.iter().zip(&mut weights.color.layers)) {
            flat_mut(&mut layer.weights).copy_from_slice(&gpu.read(&array.weights)?);
        }
        let background = gpu.read(&self.background)?;
        let used = weights.background.len();
        weights.background.copy_from_slice(&background[..used]);
        weights.refresh();
        Ok(())
    }

    /// Returns all arrays.
    pub fn arrays(&self) -> Vec<&Array<f32>> {
        let layers = self.density.iter().chain(&self.color);
        let layers = layers.map(|layer| &layer.weights);
        [&self.tables]
            .into_iter()
            .chain(layers)
            .chain([&self.background])
            .collect()
    }
}

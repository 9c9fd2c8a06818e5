//! The trained numbers of a field on a device.

use super::Gpu;
use super::array::{Array, Part};
use super::nets::{BACKGROUND, Layers};
use super::tables::Grid;
use marf_field::GpuError;
use marf_field::cpu::simd::{flat, flat_mut};
use marf_field::weights::Weights;

/// Returns the layers of both networks.
pub fn layers(weights: &Weights) -> Layers {
    let all = weights.density.layers.iter().chain(&weights.color.layers);
    Layers {
        shapes: all.map(|layer| [layer.inputs, layer.outputs]).collect(),
        density: weights.density.layers.len(),
    }
}

/// Tables, networks and background.
pub struct DeviceWeights {
    /// f32 `[entries, F]`.
    pub tables: Array<f32>,
    /// f32 [`Layers::numbers`]: both networks, then the background, f32 `[4][16]`, whose last row is unused.
    pub nets: Array<f32>,
    /// Places of the layers in it.
    pub layers: Layers,
}

impl DeviceWeights {
    /// Copies weights to a device.
    ///
    /// # Errors
    /// More than the device holds.
    pub fn new(gpu: &Gpu, grid: &Grid, weights: &Weights) -> Result<Self, GpuError> {
        let layers = layers(weights);
        let new = Self {
            tables: gpu.zeros("tables", grid.numbers())?,
            nets: gpu.zeros("networks", layers.numbers())?,
            layers,
        };
        new.write(gpu, grid, weights);
        Ok(new)
    }

    /// Overwrites them.
    pub fn write(&self, gpu: &Gpu, grid: &Grid, weights: &Weights) {
        gpu.write(&self.tables, 0, &grid.join(&weights.tables, weights.features));
        let all = weights.density.layers.iter().chain(&weights.color.layers);
        for (layer, first) in all.zip(self.layers.firsts()) {
            gpu.write(&self.nets, first, flat(&layer.weights));
        }
        gpu.write(&self.nets, self.layers.weights(), &weights.background);
    }

    /// Copies them back.
    ///
    /// # Errors
    /// A lost device.
    pub fn read(&self, gpu: &Gpu, grid: &Grid, weights: &mut Weights) -> Result<(), GpuError> {
        weights.tables = grid.split(&gpu.read(&self.tables)?, weights.features);
        let nets = gpu.read(&self.nets)?;
        let (density, color) = (&mut weights.density.layers, &mut weights.color.layers);
        for (layer, first) in density.iter_mut().chain(color).zip(self.layers.firsts()) {
            let numbers = layer.inputs * layer.outputs;
            flat_mut(&mut layer.weights).copy_from_slice(&nets[first..][..numbers]);
        }
        let used = weights.background.len();
        weights
            .background
            .copy_from_slice(&nets[self.layers.weights()..][..used]);
        weights.refresh();
        Ok(())
    }

    /// Returns the background, f32 `[4][16]`.
    pub fn background(&self) -> Part<'_> {
        self.nets.part(self.layers.weights(), BACKGROUND)
    }
}

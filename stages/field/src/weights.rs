//! The trained numbers of a field, and the shape they have.

use crate::cpu::encode::Shape;
use crate::cpu::math::root;
use crate::cpu::net::Net;
use crate::cpu::simd::{LANES, flat, flat_mut};
use crate::rng::{Purpose, random_numbers};
use crate::{Background, Config, Sizes, ViewDependence, sh};

/// Outputs of the density network: the raw density and 15 numbers for the colour network.
pub const LATENT: usize = 16;
/// Numbers a row of a network or background tensor.
pub const NET_ROW: usize = 16;

/// Everything that a ray needs but occupancy.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    /// Levels, coarse to fine.
    pub shapes: Vec<Shape>,
    /// Features an entry.
    pub features: usize,
    /// `[entries, features]` a level.
    pub tables: Vec<Vec<f32>>,
    /// Features to raw density and latent.
    pub density: Net,
    /// Latent and, with view dependence, harmonics of the direction to colour logits (3 of 16).
    pub color: Net,
    /// `[3, 16]` coefficients of the background's logits.
    pub background: Vec<f32>,
}

/// Resolutions from `base` to `finest` in equal ratios, computed without a power function.
pub fn resolutions(base: u32, finest: u32, levels: u32) -> Vec<u32> {
    let growth = root(
        f64::from(finest.max(base)) / f64::from(base),
        levels.saturating_sub(1),
    );
    let mut side = f64::from(base);
    let sides = (0..levels).map(|_| {
        let now = side;
        side *= growth;
        (now + 0.5) as u32
    });
    sides.collect()
}

impl Weights {
    /// Returns the levels of a configuration.
    pub fn shapes(config: &Config, sizes: &Sizes) -> Vec<Shape> {
        let sides = resolutions(config.base_resolution, sizes.finest.value, sizes.levels.value);
        sides
            .iter()
            .map(|side| Shape::new(*side, sizes.log2_table.value))
            .collect()
    }

    /// Blocks a row of features.
    pub fn row_blocks(&self) -> usize {
        self.shapes.len() * self.features / LANES
    }

    /// Returns weights of zero.
    pub fn zeros(config: &Config, sizes: &Sizes) -> Self {
        let shapes = Self::shapes(config, sizes);
        let features = config.features as usize;
        let tables = shapes
            .iter()
            .map(|shape| vec![0.0; shape.entries as usize * features]);
        let input = shapes.len() * features;
        let harmonics = match config.view_dependence {
            ViewDependence::On => sh::COUNT,
            ViewDependence::Off => 0,
        };
        let mut widths = vec![LATENT + harmonics];
        widths.extend((0..config.color_layers).map(|_| config.color_width as usize));
        widths.push(16);
        Self {
            tables: tables.collect(),
            shapes,
            features,
            density: Net::new(&[input, config.density_width as usize, LATENT]),
            // Three channels, and no gradient of a direction.
            color: Net::new(&widths).carrying(3, LATENT / LANES),
            background: vec![0.0; 3 * sh::COUNT],
        }
    }

    /// Draws start values: tables in +-1e-4, networks by Glorot. The background starts gray.
    pub fn randomise(&mut self, seed: u64) {
        for (level, table) in self.tables.iter_mut().enumerate() {
            let mut rng = random_numbers(seed, Purpose::Tables, 0, level as u64);
            for value in table {
                *value = 1e-4 * 2.0_f32.mul_add(rng.unit_f32(), -1.0);
            }
        }
        self.density
            .randomise(&mut random_numbers(seed, Purpose::Networks, 0, 0));
        self.color
            .randomise(&mut random_numbers(seed, Purpose::Networks, 0, 1));
    }

    /// Returns every tensor with its name, in a fixed order.
    pub fn tensors(&self) -> Vec<(String, &[f32])> {
        let tables = self.tables.iter().enumerate();
        let mut all: Vec<_> = tables
            .map(|(level, table)| (format!("table.{level}"), table.as_slice()))
            .collect();
        for (name, net) in [("density", &self.density), ("color", &self.color)] {
            let layers = net.layers.iter().enumerate();
            all.extend(layers.map(|(index, layer)| (format!("{name}.{index}"), flat(&layer.weights))));
        }
        all.push(("background".to_owned(), &self.background));
        all
    }

    /// Returns the tensors of [`Weights::tensors`], to be written. Call [`Weights::refresh`] afterwards.
    pub fn tensors_mut(&mut self) -> Vec<(String, &mut [f32])> {
        let tables = self.tables.iter_mut().enumerate();
        let mut all: Vec<_> = tables
            .map(|(level, table)| (format!("table.{level}"), table.as_mut_slice()))
            .collect();
        for (name, net) in [("density", &mut self.density), ("color", &mut self.color)] {
            let layers = net.layers.iter_mut().enumerate();
            all.extend(
                layers.map(|(index, layer)| (format!("{name}.{index}"), flat_mut(&mut layer.weights))),
            );
        }
        all.push(("background".to_owned(), &mut self.background));
        all
    }

    /// Brings what is derived from the weights up to date.
    pub fn refresh(&mut self) {
        for layer in self.density.layers.iter_mut().chain(&mut self.color.layers) {
            layer.refresh();
        }
    }

    /// Blocks of 16 that a row of the colour network's input has: the latent, and the harmonics where they count.
    pub fn color_blocks(&self) -> usize {
        self.color.layers.first().map_or(1, |layer| layer.inputs / LATENT)
    }

    /// Returns the background's colour in a direction given by its harmonics.
    #[inline(always)]
    pub fn behind(&self, kind: Background, harmonics: &[f32; sh::COUNT]) -> [f32; 3] {
        match kind {
            Background::Black => [0.0; 3],
            Background::Direction => self.logits_behind(harmonics).map(crate::cpu::composite::colour),
        }
    }

    /// Returns the background's logits.
    #[inline(always)]
    pub fn logits_behind(&self, harmonics: &[f32; sh::COUNT]) -> [f32; 3] {
        // Loops: a closure would not be compiled for the instruction set, and each multiply-add would be a call.
        let mut logits = [0.0_f32; 3];
        for (logit, row) in logits.iter_mut().zip(self.background.chunks_exact(sh::COUNT)) {
            for (a, b) in row.iter().zip(harmonics) {
                *logit = a.mul_add(*b, *logit);
            }
        }
        logits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resolutions_run_from_base_to_finest_in_equal_ratios() {
        assert_eq!(resolutions(16, 2048, 8), [16, 32, 64, 128, 256, 512, 1024, 2048]);
        assert_eq!(resolutions(16, 16, 4), [16; 4]);
        assert_eq!(resolutions(16, 9, 1), [16]);
    }
}

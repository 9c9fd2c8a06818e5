//! The networks on the device: forward, back, gradients of weights, Adam.

use marf_shaders::{self as shaders, AdamNet, MOST_LAYERS, NetsRun, Pace, SumRun, TILE_NUMBERS};

use super::Gpu;
use super::array::Array;
use super::batch::Batch;
use super::kernel::{Kernel, fold, one_each};
use super::order::{GROUPS, MOST_WORK};
use super::record::{Work, dispatch};
use marf_field::cpu::adam::{BETA1, BETA2, Bias};
use marf_field::cpu::composite::{LOGIT_LIMIT, OPAQUE, RAW_LIMIT, RAW_SHIFT, RUNAWAY};
use marf_field::schedule::{BACKGROUND_RATE, DECAY, EPSILON};
use marf_field::shade::EVEN;
use marf_field::weights::{LATENT, NET_ROW};
use marf_field::{Background, GpuError};

/// Most samples of a tile: that of networks 32 wide.
const MOST_SAMPLES: usize = 128;
/// Weights of a workgroup of the kernel `sum`, whose other axis is as many slices of the parts.
const SUMMED: usize = 16;
/// Numbers of the background on a device: a row more than channels, which stays 0.
pub const BACKGROUND: usize = 4 * NET_ROW;
/// Rays of a part of the background's gradient.
const RAYS: usize = 64;

/// Returns the head of kernels that look at the limits of the field's numbers.
pub fn limits() -> String {
    let limits = shaders::Limits {
        runaway: RUNAWAY,
        raw: RAW_LIMIT,
        shift: RAW_SHIFT,
        logit: LOGIT_LIMIT,
        opaque: OPAQUE,
        even: EVEN,
    };
    limits.head()
}

/// The layers of both networks, one behind the other in one array of weights, the background behind them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layers {
    /// `[inputs, outputs]` of the density network's layers, then of the colour network's.
    pub shapes: Vec<[usize; 2]>,
    /// Layers of the density network.
    pub density: usize,
}

impl Layers {
    /// Returns the samples of a tile: the widest layer for this many fits into workgroup memory.
    pub fn tile(&self) -> usize {
        let widest = self.shapes.iter().flatten().copied().max().unwrap_or(1);
        (TILE_NUMBERS / widest.next_power_of_two()).clamp(8, MOST_SAMPLES)
    }

    /// Returns the weights of both networks, and the place of the background behind them.
    pub fn weights(&self) -> usize {
        self.shapes.iter().map(|[inputs, outputs]| inputs * outputs).sum()
    }

    /// Returns the numbers that networks and background take.
    pub fn numbers(&self) -> usize {
        self.weights() + BACKGROUND
    }

    /// Returns the first weight of every layer.
    pub fn firsts(&self) -> Vec<usize> {
        let firsts = self.shapes.iter().scan(0, |next, [inputs, outputs]| {
            let first = *next;
            *next += inputs * outputs;
            Some(first)
        });
        firsts.collect()
    }

    /// Returns the numbers of a workgroup on the way back: gradients of all weights, then of a tile the inputs of all layers.
    fn stride(&self) -> usize {
        let columns: usize = self.shapes.iter().map(|[inputs, _]| inputs).sum();
        self.weights() + columns * self.tile()
    }

    /// Returns the workgroups of the way back.
    fn groups(&self, capacity: usize) -> usize {
        let most = GROUPS.min(MOST_WORK / self.stride().max(1)).max(1);
        most.min(capacity.div_ceil(self.tile()))
    }

    /// Returns the numbers of [`Back::work`] for `capacity` samples and `rays` rays.
    pub fn work(&self, capacity: usize, rays: usize) -> usize {
        self.behind(capacity) + rays.div_ceil(RAYS) * BACKGROUND
    }

    /// Returns the place in [`Back::work`] of the parts of the background's gradient, a multiple of 256 bytes.
    pub fn behind(&self, capacity: usize) -> usize {
        self.groups(capacity) * self.stride()
    }

    /// Returns the head of the kernels.
    fn head(&self) -> String {
        shaders::tile_head(self.tile() / 4, self.shapes.len(), self.density) + &limits()
    }

    fn run(&self, capacity: usize) -> NetsRun {
        let mut shapes = [[0; 4]; MOST_LAYERS];
        let mut row = 0;
        for ((to, [inputs, outputs]), first) in shapes.iter_mut().zip(&self.shapes).zip(self.firsts()) {
            *to = [*inputs as u32, *outputs as u32, first as u32, row];
            row += *inputs as u32;
        }
        let seen = self.shapes.get(self.density).map_or(0, |[inputs, _]| *inputs);
        NetsRun {
            capacity: capacity as u32,
            weights: self.weights() as u32,
            directed: u32::from(seen > LATENT),
            stride: self.stride() as u32,
            groups: self.groups(capacity) as u32,
            latents: LATENT as u32,
            pad: [0; 2],
            shapes,
        }
    }
}

/// Kept samples as the colour network sees them.
#[derive(Clone, Copy)]
pub struct KeptSamples<'a> {
    /// u32 `[capacity]`: which of the visited samples a kept one was.
    pub origin: &'a Array<u32>,
    /// u32 `[capacity]`: rays of visited samples.
    pub ray_of: &'a Array<u32>,
    /// `[rays]`: direction, and 1 where there is a ray.
    pub directions: &'a Array<[f32; 4]>,
}

/// Which outputs of the density network are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rows {
    /// All that the colour network reads.
    All,
    /// The raw density, row 0, and those that are computed with it.
    Density,
}

/// What the way back reads and writes.
#[derive(Clone, Copy)]
pub struct Back<'a> {
    /// f32 `[inputs][capacity]`, of visited samples.
    pub features: &'a Array<f32>,
    /// Kept samples.
    pub seen: KeptSamples<'a>,
    /// f32 [`Layers::numbers`].
    pub weights: &'a Array<f32>,
    /// f32 `[4][capacity]`: slopes in the logits and in the raw density.
    pub d_outputs: &'a Array<f32>,
    /// f32 [`Layers::work`].
    pub work: &'a Array<f32>,
    /// Receives the slopes of the features, f32 `[inputs][capacity]`, of kept samples.
    pub slopes: &'a Array<f32>,
}

/// What Adam moves, in rows of 16 numbers: networks, then background.
#[derive(Clone, Copy)]
pub struct Tensor<'a> {
    /// f32 `[rows][16]`.
    pub weights: &'a Array<f32>,
    /// f32 `[rows][16]`. 0 afterwards.
    pub gradient: &'a Array<f32>,
    /// f32 `[rows][16]`.
    pub mean: &'a Array<f32>,
    /// f32 `[rows][16]`.
    pub square: &'a Array<f32>,
    /// u32 `[rows]`.
    pub count: &'a Array<u32>,
    /// f32 `[rows][16]`: follows the weights.
    pub average: &'a Array<f32>,
}

/// Other inputs of Adam.
#[derive(Clone, Copy)]
pub struct Rates<'a> {
    /// The uniform that holds the learning rate.
    pub pace: &'a Array<Pace>,
    /// From [`Nets::bias`].
    pub bias: &'a Array<[f32; 2]>,
}

/// The kernels of networks.
pub struct Nets {
    layers: Layers,
    density: Kernel,
    shade: Kernel,
    sum: Kernel,
    adam: Kernel,
}

impl Nets {
    /// Compiles them.
    ///
    /// # Errors
    /// [`GpuError::Kernel`].
    pub fn new(gpu: &Gpu, layers: &Layers) -> Result<Self, GpuError> {
        let head = layers.head();
        Ok(Self {
            layers: layers.clone(),
            density: gpu.kernel(&shaders::DENSITY, &head)?,
            shade: gpu.kernel(&shaders::SHADE, &head)?,
            sum: gpu.kernel(&shaders::SUM, &limits())?,
            adam: gpu.kernel(&shaders::ADAM_NET, "")?,
        })
    }

    fn uniform(&self, batch: Batch<'_>) -> Result<Array<NetsRun>, GpuError> {
        batch.gpu.uniform("networks", self.layers.run(batch.capacity))
    }

    fn tiles(&self, batch: Batch<'_>) -> [usize; 3] {
        fold(batch.capacity.div_ceil(self.layers.tile()))
    }

    /// Binds the density network over visited samples: features to f32 `[16][capacity]`. It writes only
    /// `rows` of these.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn density(
        &self,
        batch: Batch<'_>,
        weights: &Array<f32>,
        features: &Array<f32>,
        latent: &Array<f32>,
        rows: Rows,
    ) -> Result<Work, GpuError> {
        let latents = match rows {
            Rows::All => LATENT,
            Rows::Density => 8,
        };
        let run = NetsRun {
            latents: latents as u32,
            ..self.layers.run(batch.capacity)
        };
        let run = batch.gpu.uniform("networks", run)?;
        let parts = [
            (&run).into(),
            batch.counts.into(),
            features.into(),
            weights.into(),
            latent.into(),
        ];
        Ok(dispatch(batch.gpu, &self.density, &parts, self.tiles(batch)))
    }

    /// Binds the colour network over kept samples: `latent` of visited ones to f32 `[6][capacity]`, colours and logits.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn shade(
        &self,
        batch: Batch<'_>,
        weights: &Array<f32>,
        seen: KeptSamples<'_>,
        latent: &Array<f32>,
        colours: &Array<f32>,
    ) -> Result<Work, GpuError> {
        let run = self.uniform(batch)?;
        let parts = [
            (&run).into(),
            batch.counts.into(),
            latent.into(),
            seen.origin.into(),
            seen.ray_of.into(),
            seen.directions.into(),
            weights.into(),
            colours.into(),
            batch.faults.into(),
        ];
        Ok(dispatch(batch.gpu, &self.shade, &parts, self.tiles(batch)))
    }

    /// Binds the way back through both networks.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn back(&self, batch: Batch<'_>, arrays: Back<'_>) -> Result<Work, GpuError> {
        let run = self.uniform(batch)?;
        let parts = [
            (&run).into(),
            batch.counts.into(),
            arrays.features.into(),
            arrays.seen.origin.into(),
            arrays.seen.ray_of.into(),
            arrays.seen.directions.into(),
            arrays.weights.into(),
            arrays.d_outputs.into(),
            arrays.work.into(),
            arrays.slopes.into(),
            batch.faults.into(),
        ];
        let groups = fold(self.layers.groups(batch.capacity));
        // Compiled where it is bound: a device that only renders may lack the bindings.
        let tiles = batch.capacity.div_ceil(self.layers.tile());
        let rounds = tiles.div_ceil(self.layers.groups(batch.capacity));
        let head = self.layers.head() + &shaders::rounds_head(rounds);
        let kernel = batch.gpu.kernel(&shaders::BACK, &head)?;
        Ok(dispatch(batch.gpu, &kernel, &parts, groups))
    }

    /// Binds the sum of all parts to f32 [`Layers::numbers`]. `behind` is whether the background is learnt.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn sum(
        &self,
        batch: Batch<'_>,
        behind: Background,
        work: &Array<f32>,
        gradient: &Array<f32>,
    ) -> Result<Work, GpuError> {
        let run = SumRun {
            weights: self.layers.weights() as u32,
            stride: self.layers.stride() as u32,
            groups: self.layers.groups(batch.capacity) as u32,
            samples: self.layers.tile() as u32,
            first: self.layers.behind(batch.capacity) as u32,
            behind: u32::from(behind == Background::Direction),
            pad: [0; 2],
        };
        let run = batch.gpu.uniform("sum", run)?;
        let parts = [
            (&run).into(),
            batch.counts.into(),
            work.into(),
            gradient.into(),
            batch.faults.into(),
        ];
        let groups = fold(self.layers.numbers().div_ceil(SUMMED));
        Ok(dispatch(batch.gpu, &self.sum, &parts, groups))
    }

    /// Binds a step of Adam, which does nothing once there is a fault.
    ///
    /// # Errors
    /// The memory of a uniform.
    pub fn adam(&self, batch: Batch<'_>, rates: Rates<'_>, tensor: Tensor<'_>) -> Result<Work, GpuError> {
        let rows = self.layers.numbers() / NET_ROW;
        let run = AdamNet {
            rows: rows as u32,
            last: rates.bias.len().saturating_sub(1) as u32,
            behind: (self.layers.weights() / NET_ROW) as u32,
            factor: BACKGROUND_RATE,
            decay: DECAY,
            epsilon: EPSILON,
            beta1: BETA1,
            beta2: BETA2,
        };
        let run = batch.gpu.uniform("adam of nets", run)?;
        let parts = [
            (&run).into(),
            rates.pace.into(),
            batch.faults.into(),
            rates.bias.into(),
            tensor.weights.into(),
            tensor.gradient.into(),
            tensor.mean.into(),
            tensor.square.into(),
            tensor.count.into(),
            tensor.average.into(),
        ];
        Ok(dispatch(batch.gpu, &self.adam, &parts, one_each(rows)))
    }

    /// Uploads the table of Adam's corrections.
    ///
    /// # Errors
    /// The memory.
    pub fn bias(gpu: &Gpu, bias: &Bias) -> Result<Array<[f32; 2]>, GpuError> {
        gpu.filled("bias", bias.corrections())
    }
}

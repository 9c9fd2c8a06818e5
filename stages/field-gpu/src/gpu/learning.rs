//! The backward pass: from the loss of a batch to new weights, bound to the arrays of a training.

use marf_shaders::{counts, found};

use super::Gpu;
use super::array::Array;
use super::arrays::Arrays;
use super::exposures::{ExposureInputs, ExposurePasses, Exposures};
use super::forward::{Kernels as Shared, Lanes};
use super::light::{Aims, SlopeArrays};
use super::nets::{Back, Rates as NetRates, Tensor};
use super::record::{Recorder, Work};
use super::tables::{AdamArrays, AdamTable, Grid, ScaleArrays, Scales, Scatter, ScatterArrays, Slots, Sums};
use super::weights::DeviceWeights;
use marf_field::{Background, Config, Gain, GpuError};

/// The kernels of the backward pass.
pub struct Kernels {
    scatter: Scatter,
    scales: Scales,
    adam: AdamTable,
    exposures: Exposures,
}

impl Kernels {
    /// Compiles the kernels for entries of `features` numbers.
    ///
    /// # Errors
    /// A driver that does not.
    pub fn new(gpu: &Gpu, features: usize) -> Result<Self, GpuError> {
        let sums = Sums::from_gpu(gpu);
        Ok(Self {
            scatter: Scatter::new(gpu, features, sums)?,
            scales: Scales::new(gpu, features, sums)?,
            adam: AdamTable::new(gpu, features, sums)?,
            exposures: Exposures::new(gpu)?,
        })
    }
}

/// The passes of a step behind the colours, bound to their arrays.
pub struct Learning {
    /// From colours to gradients, including the totals. No kept state changes.
    pub back: Work,
    /// Sums of exposures' slopes and their step. `None` where photos share one exposure.
    exposing: Option<ExposurePasses>,
    /// The scales of the tables' gradients.
    pub scale: Work,
    /// All weights, and their averages where these are due.
    moves: Work,
}

/// Kernels and arrays that are bound together.
#[derive(Clone, Copy)]
pub struct Bindings<'a> {
    /// The device.
    pub gpu: &'a Gpu,
    /// Kernels shared with pictures.
    pub shared: &'a Shared,
    /// Kernels of the backward pass.
    pub kernels: &'a Kernels,
    /// The levels.
    pub grid: &'a Grid,
    /// The weights.
    pub weights: &'a DeviceWeights,
    /// Their average.
    pub average: &'a DeviceWeights,
    /// Arrays of the batch.
    pub lanes: &'a Lanes,
    /// Arrays of the training.
    pub arrays: &'a Arrays,
    /// Hyper-parameters.
    pub config: &'a Config,
    /// The uniform of a step.
    pub step: &'a Array<marf_shaders::Step>,
}

impl Learning {
    /// Binds the kernels to their arrays.
    ///
    /// # Errors
    /// Memory that was refused.
    pub fn new(bindings: Bindings<'_>) -> Result<Self, GpuError> {
        let Bindings {
            gpu, lanes, arrays, ..
        } = bindings;
        let exposing = (bindings.config.gain != Gain::Off).then(|| {
            let inputs = ExposureInputs {
                step: bindings.step,
                counts: &lanes.counts,
                targets: &lanes.rays.targets,
                slopes: &arrays.found,
                bias: &arrays.bias,
                faults: &lanes.faults,
            };
            bindings.kernels.exposures.bind(gpu, &arrays.exposures, inputs)
        });
        Ok(Self {
            back: bindings.losses()?.then(bindings.nets()?).then(bindings.tables()?),
            exposing,
            scale: bindings.scales()?,
            moves: bindings.moves()?,
        })
    }

    /// Records a step behind the colours.
    pub fn record(&self, recorder: &mut Recorder<'_>, rays: usize) {
        self.back.record_for(recorder, rays);
        if let Some(exposing) = &self.exposing {
            exposing.record_sums(recorder);
        }
        self.scale.record(recorder);
        self.moves.record(recorder);
        if let Some(exposing) = &self.exposing {
            exposing.record_learn(recorder);
        }
    }
}

impl Bindings<'_> {
    /// Returns the passes from colours to the slopes of logits and raw densities.
    fn losses(self) -> Result<Work, GpuError> {
        let (lanes, arrays, light) = (self.lanes, self.arrays, &self.shared.light);
        let batch = lanes.batch(self.gpu);
        let behind = self.config.background == Background::Direction;
        let first = self.weights.layers.behind(lanes.capacity);
        let aims = Aims {
            directions: &lanes.rays.directions,
            targets: &lanes.rays.targets,
            gains: &arrays.exposures.gains,
            views: arrays.exposures.views,
            background: behind.then(|| self.weights.background()),
            found: &arrays.found,
            parts: arrays.work.part(first, arrays.work.len() - first),
        };
        let compare = light.compare(batch, lanes.columns(), lanes.colours().rgb, aims)?;
        let slopes = SlopeArrays {
            found: &arrays.found,
            pulls: &lanes.rays.pulls,
            d_outputs: &arrays.d_outputs,
        };
        let spread = light.spread(batch, &arrays.losses, lanes.columns(), lanes.colours(), slopes)?;
        Ok(compare.then(spread))
    }

    /// Returns the passes back through both networks to the slopes of features, and the gradients of all weights.
    fn nets(self) -> Result<Work, GpuError> {
        let (lanes, arrays, nets) = (self.lanes, self.arrays, &self.shared.nets);
        let batch = lanes.batch(self.gpu);
        let back = Back {
            features: &lanes.features,
            seen: lanes.seen(),
            weights: &self.weights.nets,
            d_outputs: &arrays.d_outputs,
            work: &arrays.work,
            slopes: &arrays.slopes,
        };
        let background = self.config.background;
        let sum = nets.sum(batch, background, &arrays.work, &arrays.nets_gradient)?;
        Ok(nets.back(batch, back)?.then(sum))
    }

    /// Returns the passes from the slopes of features to those of table entries, and the totals for the host.
    fn tables(self) -> Result<Work, GpuError> {
        let (gpu, lanes, arrays) = (self.gpu, self.lanes, self.arrays);
        let slots = Slots {
            capacity: lanes.capacity,
            slot: counts::KEPT,
        };
        let scattered = ScatterArrays {
            xyz: &lanes.visited.xyz,
            origin: &lanes.origin,
            counts: &lanes.counts,
            slopes: &arrays.slopes,
            gradient: &arrays.gradient,
            scales: &arrays.scales,
        };
        self.kernels.scatter.bind(gpu, self.grid, slots, scattered)
    }

    fn scales(self) -> Result<Work, GpuError> {
        let (arrays, kernel) = (self.arrays, &self.kernels.scales);
        let arrays = ScaleArrays {
            gradient: &arrays.gradient,
            scales: &arrays.scales,
            rescaling: &arrays.rescaling,
            faults: &self.lanes.faults,
        };
        kernel.bind(self.gpu, self.grid, arrays)
    }

    /// Returns the passes in which all weights take a step.
    fn moves(self) -> Result<Work, GpuError> {
        let (gpu, lanes, arrays) = (self.gpu, self.lanes, self.arrays);
        let batch = lanes.batch(gpu);
        let loss = arrays
            .found
            .part(found::LOSS * lanes.rays.slots, lanes.rays.slots);
        let totals = self
            .shared
            .light
            .totals(batch, &arrays.pace, loss, &arrays.ring)?;
        let trained = AdamArrays {
            rates: &arrays.rates,
            scales: &arrays.scales,
            bias: &arrays.bias,
            faults: &lanes.faults,
            gradient: &arrays.gradient,
            tables: &self.weights.tables,
            mean: &arrays.tables.mean,
            square: &arrays.tables.square,
            count: &arrays.tables.count,
            average: &self.average.tables,
        };
        let tables = self.kernels.adam.bind(gpu, self.grid, trained)?;
        let rates = NetRates {
            pace: &arrays.pace,
            bias: &arrays.bias,
        };
        let tensor = Tensor {
            weights: &self.weights.nets,
            gradient: &arrays.nets_gradient,
            mean: &arrays.nets.mean,
            square: &arrays.nets.square,
            count: &arrays.nets.count,
            average: &self.average.nets,
        };
        let nets = self.shared.nets.adam(batch, rates, tensor)?;
        Ok(totals.then(tables).then(nets))
    }
}

//! The backward pass: from the loss of a batch to new weights, bound to the arrays of a training.

use marf_shaders::{counts, faults, found};

use super::Gpu;
use super::array::Array;
use super::arrays::{Arrays, DeviceMoments, Learnt};
use super::exposures::{Exposing, ExposureInputs, Exposures};
use super::forward::{Kernels as Shared, Lanes};
use super::light::Aims;
use super::nets::{After, Gradient, Product, Rates as NetRates, Rows, Tensor};
use super::record::{Recorder, Work};
use super::tables::{AdamTable, Blend, Grid, Scales, Scatter, Scattered, Slots, Sums, Trained};
use super::weights::{DeviceLayer, DeviceWeights};
use crate::schedule::{BACKGROUND_RATE, DECAY};
use crate::weights::NET_ROW;
use crate::{Background, Config, Gain, GpuError};

/// The kernels of the backward pass.
pub struct Kernels {
    scatter: Scatter,
    scales: Scales,
    adam: AdamTable,
    blend: Blend,
    exposures: Exposures,
}

impl Kernels {
    /// Compiles the kernels for entries of `features` numbers.
    ///
    /// # Errors
    /// A driver that does not.
    pub fn new(gpu: &Gpu, features: usize) -> Result<Self, GpuError> {
        let sums = Sums::of(gpu);
        Ok(Self {
            scatter: Scatter::new(gpu, features, sums)?,
            scales: Scales::new(gpu, features, sums)?,
            adam: AdamTable::new(gpu, features, sums)?,
            blend: Blend::new(gpu)?,
            exposures: Exposures::new(gpu)?,
        })
    }
}

/// The passes of a step behind the colours, bound to their arrays.
pub struct Learning {
    /// From colours to gradients, the totals among them; nothing that is kept changes.
    pub back: Work,
    /// Sums of exposures' slopes and their step; none where photos share one exposure.
    exposing: Option<Exposing>,
    /// The scales of the tables' gradients.
    pub scale: Work,
    /// All weights, and the turned ones after them.
    pub learn: Work,
    /// The averages.
    pub blend: Work,
    /// The turned weights alone.
    pub turn: Work,
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
        let mut blend = Work::default();
        let pairs = bindings
            .weights
            .arrays()
            .into_iter()
            .zip(bindings.average.arrays());
        for (values, average) in pairs {
            let blending = &arrays.blending;
            blend = blend.then(
                bindings
                    .kernels
                    .blend
                    .bind(gpu, blending, &lanes.faults, values, average),
            );
        }
        Ok(Self {
            back: bindings.losses()?.then(bindings.nets()?).then(bindings.tables()?),
            exposing,
            scale: bindings.scales()?,
            learn: bindings.moves()?.then(bindings.turns()?),
            turn: bindings.turns()?,
            blend,
        })
    }

    /// Records a step behind the colours; `is_due`: whether the averages follow.
    pub fn record(&self, recorder: &mut Recorder<'_>, is_due: bool) {
        self.back.record(recorder);
        if let Some(exposing) = &self.exposing {
            exposing.record_sums(recorder);
        }
        self.scale.record(recorder);
        self.learn.record(recorder);
        if let Some(exposing) = &self.exposing {
            exposing.record_learn(recorder);
        }
        if is_due {
            self.blend.record(recorder);
        }
    }
}

impl Bindings<'_> {
    /// Returns the passes from colours to the slopes of logits and raw densities.
    fn losses(self) -> Result<Work, GpuError> {
        let (lanes, arrays, light) = (self.lanes, self.arrays, &self.shared.light);
        let batch = lanes.batch(self.gpu);
        let behind = self.config.background == Background::Direction;
        let aims = Aims {
            directions: &lanes.rays.directions,
            targets: &lanes.rays.targets,
            gains: &arrays.exposures.gains,
            views: arrays.exposures.views,
            background: behind.then_some(&self.weights.background),
            found: &arrays.found,
        };
        let mut work = light.compare(batch, lanes.kept_columns(), &lanes.rgb, aims)?;
        work = work.then(light.spread(
            batch,
            &arrays.losses,
            (lanes.kept_columns(), lanes.colours()),
            [&arrays.found, &arrays.d_logits],
            &lanes.rays.pulls,
        )?);
        if behind {
            work = work.then(light.harmonics_of_rays(batch, &lanes.rays.directions, &arrays.harmonics)?);
            let gradient = Gradient {
                a: (&arrays.found).into(),
                d: (&arrays.harmonics).into(),
                shape: [4, NET_ROW],
                capacity: lanes.rays.slots,
                parts: (&arrays.parts).into(),
                gradient: (&arrays.background_gradient).into(),
                fault: faults::BACKGROUND,
            };
            work = work.then(self.shared.nets.gradient(batch, counts::RAYS, gradient)?);
        }
        Ok(work)
    }

    /// Returns the passes back through both networks to the slopes of features.
    fn nets(self) -> Result<Work, GpuError> {
        let (lanes, arrays) = (self.lanes, self.arrays);
        let batch = lanes.batch(self.gpu);
        let color = self.net(
            (&self.weights.color, &arrays.color),
            [&lanes.colour_in, &arrays.d_logits],
            &lanes.colour_hidden,
        )?;
        let Some(latent) = arrays.color.first().map(|layer| &layer.slope) else {
            return Ok(color);
        };
        let join = self.shared.light.join(batch, &lanes.light[1], latent)?;
        let density = self.net(
            (&self.weights.density, &arrays.density),
            [&lanes.features[1], latent],
            &lanes.hidden[1],
        )?;
        Ok(color.then(join).then(density))
    }

    /// Returns the passes back through one network; `ends`: its input, and the slope of its output.
    fn net(
        self,
        (layers, learnt): (&[DeviceLayer], &[Learnt]),
        [input, slope]: [&Array<f32>; 2],
        hidden: &[Array<f32>],
    ) -> Result<Work, GpuError> {
        let (batch, nets) = (self.lanes.batch(self.gpu), &self.shared.nets);
        let mut work = Work::default();
        for (index, (layer, own)) in layers.iter().zip(learnt).enumerate().rev() {
            let below = index.checked_sub(1).map(|below| &hidden[below]);
            let slope = learnt.get(index + 1).map_or(slope, |above| &above.slope);
            let gradient = Gradient {
                a: below.unwrap_or(input).into(),
                d: slope.into(),
                shape: layer.shape(),
                capacity: self.lanes.capacity,
                parts: (&self.arrays.parts).into(),
                gradient: (&own.gradient).into(),
                fault: faults::NETWORKS,
            };
            work = work.then(nets.gradient(batch, counts::KEPT, gradient)?);
            let product = Product {
                a: Rows::from(slope),
                b: (&own.turned).into(),
                c: (&own.slope).into(),
                shape: [layer.outputs, layer.inputs],
                after: below.map_or(After::Nothing, |below| After::Gate(below.into())),
            };
            work = work.then(nets.product(batch, counts::KEPT, product)?);
        }
        Ok(work)
    }

    /// Returns the passes from the slopes of features to those of table entries, and the totals for the host.
    fn tables(self) -> Result<Work, GpuError> {
        let (gpu, lanes, arrays) = (self.gpu, self.lanes, self.arrays);
        let batch = lanes.batch(gpu);
        let Some(slopes) = arrays.density.first().map(|layer| &layer.slope) else {
            return Ok(Work::default());
        };
        let rows = slopes.len() / lanes.capacity;
        let light = &self.shared.light;
        let runaway = light.runaway(batch, slopes, rows, faults::FEATURES)?;
        let slots = Slots {
            capacity: lanes.capacity,
            slot: counts::KEPT,
        };
        let scattered = Scattered {
            xyz: &lanes.kept.xyz,
            counts: &lanes.counts,
            slopes,
            gradient: &arrays.gradient,
            scales: &arrays.scales,
        };
        let scatter = self.kernels.scatter.bind(gpu, self.grid, slots, scattered)?;
        Ok(runaway.then(scatter))
    }

    fn scales(self) -> Result<Work, GpuError> {
        let (arrays, kernel) = (self.arrays, &self.kernels.scales);
        let scales = (&arrays.scales, &arrays.rescaling);
        kernel.bind(self.gpu, self.grid, &arrays.gradient, scales, &self.lanes.faults)
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
        let trained = Trained {
            rates: &arrays.rates,
            scales: &arrays.scales,
            bias: &arrays.bias,
            faults: &lanes.faults,
            gradient: &arrays.gradient,
            tables: &self.weights.tables,
            mean: &arrays.tables.mean,
            square: &arrays.tables.square,
            count: &arrays.tables.count,
        };
        let tables = self.kernels.adam.bind(gpu, self.grid, trained)?;
        let mut work = totals.then(tables);
        let layers = self.weights.density.iter().chain(&self.weights.color);
        for (layer, own) in layers.zip(arrays.density.iter().chain(&arrays.color)) {
            let ends = [&layer.weights, &own.gradient];
            work = work.then(self.adam(ends, &own.moments, [1.0, DECAY])?);
        }
        if self.config.background == Background::Direction {
            let ends = [&self.weights.background, &arrays.background_gradient];
            work = work.then(self.adam(ends, &arrays.background, [BACKGROUND_RATE, 0.0])?);
        }
        Ok(work)
    }

    fn adam(
        self,
        [weights, gradient]: [&Array<f32>; 2],
        moments: &DeviceMoments,
        rates: [f32; 2],
    ) -> Result<Work, GpuError> {
        let shared = NetRates {
            pace: &self.arrays.pace,
            bias: &self.arrays.bias,
        };
        let tensor = Tensor {
            weights: weights.into(),
            gradient: gradient.into(),
            mean: (&moments.mean).into(),
            square: (&moments.square).into(),
            count: (&moments.count).into(),
            rows: weights.len() / NET_ROW,
            rates,
        };
        let batch = self.lanes.batch(self.gpu);
        self.shared.nets.adam(batch, shared, tensor)
    }

    fn turns(self) -> Result<Work, GpuError> {
        let layers = self.weights.density.iter().chain(&self.weights.color);
        let learnt = self.arrays.density.iter().chain(&self.arrays.color);
        let mut work = Work::default();
        for (layer, own) in layers.zip(learnt) {
            let (weights, turned) = ((&layer.weights).into(), (&own.turned).into());
            let nets = &self.shared.nets;
            work = work.then(nets.transpose(self.gpu, layer.shape(), weights, turned)?);
        }
        Ok(work)
    }
}

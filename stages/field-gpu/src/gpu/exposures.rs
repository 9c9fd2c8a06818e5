//! Exposure of single photos on the device.

use marf_shaders::{EXPOSURE_LEARN, EXPOSURE_SUMS, Exposed, Step, Target};

use super::Gpu;
use super::array::Array;
use super::kernel::{Bound, Kernel, fold};
use super::nets::limits;
use super::record::Recorder;
use marf_field::Gain;
use marf_field::GpuError;
use marf_field::cpu::adam::{BETA1, BETA2, Moments};
use marf_field::exposure::{LIMITS, RATE};
use marf_field::schedule::EPSILON;

/// Log gains, their moments and what they come to.
pub struct ExposureArrays {
    /// Photos.
    pub views: usize,
    /// Log gains, one row a photo, then as many offsets, if photos have them. `State::gains`.
    pub gains: Array<[f32; 4]>,
    /// Mean of the gradient, as `gains`.
    pub mean: Array<[f32; 4]>,
    /// Mean of its square, as `gains`.
    pub square: Array<[f32; 4]>,
    /// Steps of every row of `gains`.
    pub count: Array<u32>,
    /// Sums of slopes, `[2, views]` rows.
    pub sums: Array<[f32; 4]>,
    told: Array<Exposed>,
}

impl ExposureArrays {
    /// Makes exposures that change nothing yet.
    ///
    /// `row`: first row of the slopes in their array of columns of `ray_slots` numbers.
    ///
    /// # Errors
    /// More than the device holds.
    pub fn new(gpu: &Gpu, views: usize, gain: Gain, ray_slots: usize, row: usize) -> Result<Self, GpuError> {
        let rows = gain.numbers(views) / 4;
        let told = Exposed {
            views: views as u32,
            offsets: u32::from(gain == Gain::PerPhotoAndOffset),
            ray_slots: ray_slots as u32,
            share: RATE,
            limits: LIMITS,
            decays: [BETA1, BETA2],
            epsilon: EPSILON,
            row: row as u32,
        };
        Ok(Self {
            views,
            gains: gpu.zeros("gains", rows)?,
            mean: gpu.zeros("mean of gains", rows)?,
            square: gpu.zeros("square of gains", rows)?,
            count: gpu.zeros("steps of gains", rows)?,
            sums: gpu.zeros("sums of exposures", 2 * views)?,
            told: gpu.uniform("exposed", told)?,
        })
    }
}

impl ExposureArrays {
    /// Overwrites gains and moments with those of `State`.
    pub fn write(&self, gpu: &Gpu, gains: &[f32], moments: &Moments) {
        for (array, values) in [
            (&self.gains, gains),
            (&self.mean, &moments.first),
            (&self.square, &moments.second),
        ] {
            gpu.write(array, 0, bytemuck::cast_slice(values));
        }
        gpu.write(&self.count, 0, &moments.count);
    }

    /// Copies them back.
    ///
    /// # Errors
    /// A lost device.
    pub fn read(&self, gpu: &Gpu, gains: &mut [f32], moments: &mut Moments) -> Result<(), GpuError> {
        gains.copy_from_slice(gpu.read(&self.gains)?.as_flattened());
        moments
            .first
            .copy_from_slice(gpu.read(&self.mean)?.as_flattened());
        moments
            .second
            .copy_from_slice(gpu.read(&self.square)?.as_flattened());
        moments.count.copy_from_slice(&gpu.read(&self.count)?);
        Ok(())
    }
}

/// What the exposures are learnt from.
#[derive(Clone, Copy)]
pub struct ExposureInputs<'a> {
    /// Its step size.
    pub step: &'a Array<Step>,
    /// Rays in use.
    pub counts: &'a Array<u32>,
    /// Views of the rays.
    pub targets: &'a Array<Target>,
    /// Slopes in gain and offset, by columns.
    pub slopes: &'a Array<f32>,
    /// Corrections of Adam by step count, of `Bias::corrections`.
    pub bias: &'a Array<[f32; 2]>,
    /// Of [`faults::LEN`] numbers.
    pub faults: &'a Array<u32>,
}

/// The kernels of exposures.
pub struct Exposures {
    sums: Kernel,
    learn: Kernel,
}

/// Exposures, ready to be learnt.
pub struct ExposurePasses {
    views: usize,
    sums: Bound,
    learn: Bound,
}

impl Exposures {
    /// Compiles the kernels.
    ///
    /// # Errors
    /// A driver that does not.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            sums: gpu.kernel(&EXPOSURE_SUMS, &limits())?,
            learn: gpu.kernel(&EXPOSURE_LEARN, "")?,
        })
    }

    /// Binds them.
    pub fn bind(&self, gpu: &Gpu, arrays: &ExposureArrays, inputs: ExposureInputs<'_>) -> ExposurePasses {
        let told = &arrays.told;
        let sums = [
            told.into(),
            inputs.counts.into(),
            inputs.targets.into(),
            inputs.slopes.into(),
            (&arrays.gains).into(),
            (&arrays.sums).into(),
            inputs.faults.into(),
        ];
        let learn = [
            inputs.step.into(),
            told.into(),
            (&arrays.sums).into(),
            inputs.bias.into(),
            inputs.faults.into(),
            (&arrays.gains).into(),
            (&arrays.mean).into(),
            (&arrays.square).into(),
            (&arrays.count).into(),
        ];
        ExposurePasses {
            views: arrays.views,
            sums: gpu.bind(&self.sums, &sums),
            learn: gpu.bind(&self.learn, &learn),
        }
    }
}

impl ExposurePasses {
    /// Records the sums of slopes and the search for faults: before any weight changes.
    pub fn record_sums(&self, recorder: &mut Recorder<'_>) {
        recorder.groups(&self.sums, fold(self.views));
    }

    /// Records one step of log gains and offsets.
    pub fn record_learn(&self, recorder: &mut Recorder<'_>) {
        recorder.groups(&self.learn, [1, 1, 1]);
    }
}

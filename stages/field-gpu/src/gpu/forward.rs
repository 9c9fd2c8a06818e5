//! From rays to the colours of samples: what training and pictures share.

use marf_shaders::{Extent, Walk, counts, faults};

use super::Gpu;
use super::array::Array;
use super::batch::{Batch, BatchSize};
use super::light::{Colours, Columns, Light};
use super::march::{MarchArrays, SampleArrays, Scan, ScanArrays, WALKED};
use super::nets::{KeptSamples, Layers, Nets, Rows};
use super::picture::STATE;
use super::rays::{Progress, RayArrays};
use super::record::{Groups, Work};
use super::tables::{Encode, EncodeArrays, Grid, Slots};
use super::weights::{DeviceWeights, layers};
use marf_field::GpuError;
use marf_field::cpu::march::Steps;
use marf_field::weights::{LATENT, Weights};

/// Arrays of the samples of a batch. Kept samples are those of the visited ones that show.
pub struct Lanes {
    /// Sample slots, a multiple of 256.
    pub capacity: usize,
    /// How many samples of a ray are kept: all that show, until a training says otherwise.
    pub chosen: Array<Extent>,
    /// u32 `[counts::LEN]`.
    pub counts: Array<u32>,
    /// u32 `[faults::LEN]`.
    pub faults: Array<u32>,
    /// The rays.
    pub rays: RayArrays,
    /// How far rays have come.
    pub progress: Progress,
    /// Samples of every ray.
    pub amounts: Array<u32>,
    /// u32 `[WALKED][rays]`: spans, and what a walk counts for itself.
    walked: Array<u32>,
    /// u32 `[4][rays]`: first sample and number of visited samples, then of kept ones.
    pub spans: Array<u32>,
    /// Visited samples.
    pub visited: SampleArrays,
    /// Features of visited samples, f32 `[L * F][capacity]`.
    pub features: Array<f32>,
    /// f32 `[16][capacity]`, outputs of the density network of visited samples.
    pub latent: Array<f32>,
    /// Tau, alpha, transmittance of visited samples.
    pub light: Array<f32>,
    /// What `opacity` writes of rays.
    pub shown: Array<u32>,
    /// Index of the visited sample of each kept one. In an update of the occupancy, the cells of probes.
    pub origin: Array<u32>,
    /// f32 `[STATE][rays]`. All 0 in training.
    pub state: Array<f32>,
    /// f32 `[6][capacity]`: colours of kept samples, then their logits.
    pub colours: Array<f32>,
    /// The walk over visited samples, and the one for the scan of kept ones.
    pub walks: [Array<Walk>; 2],
    /// Begin and length of every step.
    pub steps: Array<[f32; 2]>,
}

/// What a batch is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// There is a way back.
    Training,
    /// There is none.
    Picture,
}

impl Lanes {
    /// Allocates the arrays. `most_steps` is the longest table of steps there will be.
    ///
    /// # Errors
    /// More than one binding or the device holds.
    pub fn new(
        gpu: &Gpu,
        weights: &DeviceWeights,
        size: BatchSize,
        most_steps: &Steps,
    ) -> Result<Self, GpuError> {
        let BatchSize {
            samples: capacity,
            rays,
        } = size;
        let columns = |what, rows: usize| gpu.zeros::<f32>(what, rows * capacity);
        let inputs = weights.layers.shapes.first().map_or(0, |[inputs, _]| *inputs);
        let walked = gpu.zeros("spans", WALKED * rays)?;
        Ok(Self {
            capacity,
            chosen: gpu.uniform("chosen samples", size.extent(0))?,
            counts: gpu.zeros("counts", counts::LEN)?,
            faults: gpu.zeros("faults", faults::LEN)?,
            rays: RayArrays::new(gpu, rays)?,
            progress: Progress::new(gpu, rays)?,
            amounts: gpu.zeros("samples of rays", rays)?,
            spans: walked.share(0, 4 * rays),
            walked,
            visited: SampleArrays::new(gpu, capacity)?,
            features: columns("features", inputs)?,
            latent: columns("latent", LATENT)?,
            light: columns("light", 3)?,
            shown: gpu.zeros("samples that show", size.shown_words())?,
            origin: gpu.zeros("origin of kept samples", capacity)?,
            state: gpu.zeros("state of rays", STATE * rays)?,
            colours: columns("colours", 6)?,
            walks: [
                gpu.uniform("walk", bytemuck::Zeroable::zeroed())?,
                gpu.uniform("kept walk", bytemuck::Zeroable::zeroed())?,
            ],
            steps: gpu.zeros("steps", most_steps.begin.len())?,
        })
    }

    /// Returns the arrays and sizes that kernels of a batch share.
    pub fn batch<'a>(&'a self, gpu: &'a Gpu) -> Batch<'a> {
        Batch {
            gpu,
            counts: &self.counts,
            faults: &self.faults,
            capacity: self.capacity,
            rays: self.rays.slots,
        }
    }

    /// Returns the arrays that the walk over visited samples reads and writes.
    pub fn marched<'a>(&'a self, bits: &'a Array<u32>) -> MarchArrays<'a> {
        MarchArrays {
            walk: &self.walks[0],
            rays: &self.rays,
            steps: &self.steps,
            bits,
            progress: &self.progress,
            amounts: &self.amounts,
            walked: &self.walked,
            counts: &self.counts,
            samples: &self.visited,
        }
    }

    /// Returns kept samples as the colour network sees them.
    pub fn seen(&self) -> KeptSamples<'_> {
        KeptSamples {
            origin: &self.origin,
            ray_of: &self.visited.ray_of,
            directions: &self.rays.directions,
        }
    }

    /// Returns the columns of visited samples.
    pub fn columns(&self) -> Columns<'_> {
        Columns {
            spans: &self.spans,
            along: &self.visited.along,
            density: &self.latent,
            light: &self.light,
        }
    }

    /// Returns the colours of kept samples.
    pub fn colours(&self) -> Colours<'_> {
        Colours::new(&self.colours)
    }
}

/// Checks that one binding holds the largest array of a batch, before any memory is taken.
///
/// # Errors
/// [`GpuError::Limit`].
pub fn check_columns(
    gpu: &Gpu,
    weights: &Weights,
    size: BatchSize,
    purpose: Purpose,
) -> Result<(), GpuError> {
    let layers = layers(weights);
    let inputs = layers.shapes.first().map_or(0, |[inputs, _]| *inputs);
    let work = match purpose {
        Purpose::Training => layers.work(size.samples, size.rays),
        Purpose::Picture => 0,
    };
    let needed = work.max(inputs.max(LATENT) * size.samples) * size_of::<f32>();
    gpu.check_binding(
        needed as u64,
        "lower `batch_samples` or the widths of the networks",
    )
}

/// The passes over a batch, bound to their arrays.
pub struct Forward {
    /// Raw density and latent of visited samples.
    pub densities: Work,
    /// Opacities, the choice of samples that show, and their colours.
    pub colours: Work,
}

/// The kernels that a forward pass needs.
pub struct Kernels {
    pub nets: Nets,
    pub light: Light,
    pub encode: Encode,
    pub scan: Scan,
}

impl Kernels {
    /// Compiles them for entries of `features` numbers.
    ///
    /// # Errors
    /// A driver that does not.
    pub fn new(gpu: &Gpu, features: usize, layers: &Layers) -> Result<Self, GpuError> {
        Ok(Self {
            nets: Nets::new(gpu, layers)?,
            light: Light::new(gpu)?,
            encode: Encode::new(gpu, features)?,
            scan: Scan::new(gpu)?,
        })
    }
}

impl Forward {
    /// Binds them.
    ///
    /// # Errors
    /// Memory that was refused.
    pub fn new(
        gpu: &Gpu,
        kernels: &Kernels,
        grid: &Grid,
        weights: &DeviceWeights,
        lanes: &Lanes,
    ) -> Result<Self, GpuError> {
        Ok(Self {
            densities: lanes.densities(gpu, kernels, grid, weights, Rows::All)?,
            colours: colours(gpu, kernels, weights, lanes)?,
        })
    }
}

impl Lanes {
    /// Binds the passes from places of visited samples to the outputs of the density network.
    ///
    /// # Errors
    /// Memory that was refused.
    pub fn densities(
        &self,
        gpu: &Gpu,
        kernels: &Kernels,
        grid: &Grid,
        weights: &DeviceWeights,
        rows: Rows,
    ) -> Result<Work, GpuError> {
        let slots = Slots {
            capacity: self.capacity,
            slot: counts::VISITED,
        };
        let arrays = EncodeArrays {
            xyz: &self.visited.xyz,
            counts: &self.counts,
            tables: &weights.tables,
            features: &self.features,
        };
        let encode = kernels.encode.bind(gpu, grid, slots, arrays)?;
        let batch = self.batch(gpu);
        let net = kernels
            .nets
            .density(batch, &weights.nets, &self.features, &self.latent, rows)?;
        Ok(encode.then(net))
    }
}

fn colours(gpu: &Gpu, kernels: &Kernels, weights: &DeviceWeights, lanes: &Lanes) -> Result<Work, GpuError> {
    let (batch, light) = (lanes.batch(gpu), &kernels.light);
    let mut work = Work::default();
    work = work.then(light.opacity(batch, &lanes.chosen, lanes.columns(), &lanes.state, &lanes.shown));
    let scan = ScanArrays {
        walk: &lanes.walks[1],
        amounts: &lanes.shown,
        spans: lanes.spans.part(2 * lanes.rays.slots, 2 * lanes.rays.slots),
        counts: &lanes.counts,
        samples: &lanes.visited,
    };
    let scan = kernels.scan.bind(gpu, scan);
    work.add(scan, Groups::OfRays(lanes.rays.slots, Scan::groups));
    work = work.then(light.kept(batch, &lanes.spans, &lanes.shown, &lanes.origin)?);
    let shade = kernels
        .nets
        .shade(batch, &weights.nets, lanes.seen(), &lanes.latent, &lanes.colours)?;
    Ok(work.then(shade))
}

/// Writes how many samples of a ray are kept, about. 0: all that show.
pub fn write_chosen(gpu: &Gpu, lanes: &Lanes, most: u32) {
    gpu.write(&lanes.chosen, 0, &[lanes.batch(gpu).size().extent(most)]);
}

/// Writes the number of rays to the uniforms of the walks of a batch.
pub fn write_walks(gpu: &Gpu, lanes: &Lanes, whole: Walk) {
    gpu.write(&lanes.walks[0], 0, &[whole]);
    gpu.write(&lanes.walks[1], 0, &[super::march::kept_walk(whole)]);
}

//! From rays to the colours of samples: what training and pictures share.

use marf_shaders::{Walk, counts, faults};

use super::Gpu;
use super::array::Array;
use super::light::{Colours, Columns, Light};
use super::march::{MarchArrays, SampleArrays, Scan};
use super::nets::{After, Batch, Gradient, Nets, Product, Rows};
use super::picture::STATE;
use super::rays::{Progress, RayArrays};
use super::record::Work;
use super::tables::{Encode, Encoded, Grid, Slots};
use super::weights::{DeviceLayer, DeviceWeights};
use crate::GpuError;
use crate::cpu::march::Steps;
use crate::sh;
use crate::weights::{LATENT, Weights};

/// Arrays of the samples of a batch. Kept samples are those of the visited ones that show.
pub struct Lanes {
    /// Sample slots, a multiple of 256.
    pub capacity: usize,
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
    /// Spans of visited and of kept samples.
    pub spans: [Array<u32>; 2],
    /// Visited samples.
    pub visited: SampleArrays,
    /// Kept samples.
    pub kept: SampleArrays,
    /// Features of visited and of kept samples, f32 `[L * F][capacity]`.
    pub features: [Array<f32>; 2],
    /// Outputs of the density network's hidden layers, of visited and of kept samples.
    pub hidden: [Vec<Array<f32>>; 2],
    /// f32 `[16][capacity]`, outputs of the density network of visited samples.
    pub latent: Array<f32>,
    /// Tau, alpha, transmittance of visited and of kept samples.
    pub light: [Array<f32>; 2],
    /// What `opacity` writes of rays.
    pub shown: Array<u32>,
    /// Which visited sample a kept one was; in an update of the occupancy, the cells of probes.
    pub origin: Array<u32>,
    /// f32 `[STATE][rays]`; all 0 in training.
    pub state: Array<f32>,
    /// Input of the colour network, kept samples: latent, then harmonics.
    pub colour_in: Array<f32>,
    /// Outputs of the colour network's hidden layers.
    pub colour_hidden: Vec<Array<f32>>,
    /// f32 `[16][capacity]`.
    pub logits: Array<f32>,
    /// f32 `[3][capacity]`.
    pub rgb: Array<f32>,
    /// The walk over visited samples, and the one for the scan of kept ones.
    pub walks: [Array<Walk>; 2],
    /// Begin and length of every step.
    pub steps: Array<[f32; 2]>,
}

/// What a batch is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Features and hidden layers are kept for the way back.
    Training,
    /// They are not.
    Picture,
}

impl Lanes {
    /// Allocates the arrays; `most_steps` is the longest table of steps there will be.
    ///
    /// # Errors
    /// More than one binding or the device holds.
    pub fn new(
        gpu: &Gpu,
        weights: &DeviceWeights,
        [capacity, rays]: [usize; 2],
        most_steps: &Steps,
        purpose: Purpose,
    ) -> Result<Self, GpuError> {
        let columns = |what, rows: usize| gpu.zeros::<f32>(what, rows * capacity);
        let kept = |rows: usize| if purpose == Purpose::Training { rows } else { 0 };
        let hidden = |layers: &[DeviceLayer], rows: &dyn Fn(usize) -> usize| {
            let layers = layers.iter().take(layers.len().saturating_sub(1));
            let arrays = layers.map(|layer| columns("hidden layer", rows(layer.outputs)));
            arrays.collect::<Result<Vec<_>, _>>()
        };
        let first = |layers: &[DeviceLayer]| layers.first().map_or(0, |layer| layer.inputs);
        let inputs = first(&weights.density);
        Ok(Self {
            capacity,
            counts: gpu.zeros("counts", counts::LEN)?,
            faults: gpu.zeros("faults", faults::LEN)?,
            rays: RayArrays::new(gpu, rays)?,
            progress: Progress::new(gpu, rays)?,
            amounts: gpu.zeros("samples of rays", rays)?,
            spans: [gpu.zeros("spans", 2 * rays)?, gpu.zeros("kept spans", 2 * rays)?],
            visited: SampleArrays::new(gpu, capacity)?,
            kept: SampleArrays::new(gpu, capacity)?,
            features: [
                columns("features", inputs)?,
                columns("kept features", kept(inputs))?,
            ],
            hidden: [
                hidden(&weights.density, &|rows| rows)?,
                hidden(&weights.density, &kept)?,
            ],
            latent: columns("latent", LATENT)?,
            light: [columns("light", 3)?, columns("kept light", 3)?],
            shown: gpu.zeros("samples that show", 2 * rays)?,
            origin: gpu.zeros("origin of kept samples", capacity)?,
            state: gpu.zeros("state of rays", STATE * rays)?,
            colour_in: columns("input of colours", first(&weights.color))?,
            colour_hidden: hidden(&weights.color, &|rows| rows)?,
            logits: columns("logits", 16)?,
            rgb: columns("colours", 3)?,
            walks: [
                gpu.uniform("walk", bytemuck::Zeroable::zeroed())?,
                gpu.uniform("kept walk", bytemuck::Zeroable::zeroed())?,
            ],
            steps: gpu.zeros("steps", most_steps.begin.len())?,
        })
    }

    /// Returns what kernels of a batch share.
    pub fn batch<'a>(&'a self, gpu: &'a Gpu) -> Batch<'a> {
        Batch {
            gpu,
            counts: &self.counts,
            faults: &self.faults,
            capacity: self.capacity,
            rays: self.rays.slots,
        }
    }

    /// Returns what the walk over visited samples reads and writes.
    pub fn marched<'a>(&'a self, bits: &'a Array<u32>) -> MarchArrays<'a> {
        MarchArrays {
            walk: &self.walks[0],
            rays: &self.rays,
            steps: &self.steps,
            bits,
            progress: &self.progress,
            amounts: &self.amounts,
            spans: &self.spans[0],
            counts: &self.counts,
            samples: &self.visited,
        }
    }

    /// Returns the columns of visited samples.
    fn visited_columns(&self) -> Columns<'_> {
        Columns {
            spans: &self.spans[0],
            along: &self.visited.along,
            density: &self.latent,
            light: &self.light[0],
        }
    }

    /// Returns the columns of kept samples.
    pub fn kept_columns(&self) -> Columns<'_> {
        Columns {
            spans: &self.spans[1],
            along: &self.kept.along,
            density: &self.colour_in,
            light: &self.light[1],
        }
    }

    /// Returns the colours of kept samples.
    pub fn colours(&self) -> Colours<'_> {
        Colours {
            logits: &self.logits,
            rgb: &self.rgb,
        }
    }
}

/// Checks that one binding holds the largest array of a batch, before any memory is taken.
///
/// # Errors
/// [`GpuError::Limit`].
pub fn check_columns(gpu: &Gpu, weights: &Weights, capacity: usize) -> Result<(), GpuError> {
    let layers = weights.density.layers.iter().chain(&weights.color.layers);
    let numbers = layers.map(|layer| {
        let shape = [layer.inputs, layer.outputs];
        let columns = shape.map(|width| width * capacity);
        columns
            .into_iter()
            .fold(Gradient::parts(capacity, shape), usize::max)
    });
    let needed = numbers.max().unwrap_or(0) * size_of::<f32>();
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
    pub fn new(gpu: &Gpu, features: usize) -> Result<Self, GpuError> {
        Ok(Self {
            nets: Nets::new(gpu)?,
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
        purpose: Purpose,
    ) -> Result<Self, GpuError> {
        Ok(Self {
            densities: densities(gpu, kernels, grid, weights, lanes)?,
            colours: colours(gpu, kernels, weights, lanes, purpose)?,
        })
    }
}

fn densities(
    gpu: &Gpu,
    kernels: &Kernels,
    grid: &Grid,
    weights: &DeviceWeights,
    lanes: &Lanes,
) -> Result<Work, GpuError> {
    let slots = Slots {
        capacity: lanes.capacity,
        slot: counts::VISITED,
    };
    let encoded = Encoded {
        xyz: &lanes.visited.xyz,
        counts: &lanes.counts,
        tables: &weights.tables,
        features: &lanes.features[0],
    };
    let encode = kernels.encode.bind(gpu, grid, slots, encoded)?;
    let net = net(
        lanes.batch(gpu),
        &kernels.nets,
        counts::VISITED,
        &weights.density,
        [&lanes.features[0], &lanes.latent],
        &lanes.hidden[0],
    )?;
    Ok(encode.then(net))
}

/// Binds all layers of a network, ReLU between them; `ends`: its input and its output.
fn net(
    batch: Batch<'_>,
    nets: &Nets,
    slot: u32,
    layers: &[DeviceLayer],
    [input, output]: [&Array<f32>; 2],
    hidden: &[Array<f32>],
) -> Result<Work, GpuError> {
    let mut work = Work::default();
    for (index, layer) in layers.iter().enumerate() {
        let before = index.checked_sub(1).map_or(input, |before| &hidden[before]);
        let (to, after) = match hidden.get(index) {
            Some(hidden) => (hidden, After::Relu),
            None => (output, After::Nothing),
        };
        let product = Product {
            a: before.into(),
            b: (&layer.weights).into(),
            c: to.into(),
            shape: layer.shape(),
            after,
        };
        work = work.then(nets.product(batch, slot, product)?);
    }
    Ok(work)
}

fn colours(
    gpu: &Gpu,
    kernels: &Kernels,
    weights: &DeviceWeights,
    lanes: &Lanes,
    purpose: Purpose,
) -> Result<Work, GpuError> {
    let (batch, light) = (lanes.batch(gpu), &kernels.light);
    let mut work = Work::default();
    let opacity = light.opacity(
        batch,
        counts::RAYS,
        lanes.visited_columns(),
        &lanes.state,
        &lanes.shown,
    )?;
    work = work.then(opacity);
    let [visited, kept] = &lanes.spans;
    let scan = kernels.scan.bind(
        gpu,
        &lanes.walks[1],
        &lanes.shown,
        kept,
        &lanes.counts,
        &lanes.kept,
    );
    work.add(scan, [1, 1, 1]);
    work = work.then(light.kept(batch, counts::RAYS, [visited, kept], &lanes.origin)?);
    for (from, to, rows) in gathered(lanes, purpose) {
        work = work.then(light.gather(batch, &lanes.origin, from, to, rows)?);
    }
    let inputs = weights.color.first().map_or(0, |layer| layer.inputs);
    if inputs > LATENT {
        let to = Rows {
            part: (&lanes.colour_in).into(),
            first: LATENT,
        };
        debug_assert_eq!(inputs, LATENT + sh::COUNT);
        work = work.then(light.harmonics(batch, &lanes.rays.directions, &lanes.kept.ray_of, to)?);
    }
    let net = net(
        batch,
        &kernels.nets,
        counts::KEPT,
        &weights.color,
        [&lanes.colour_in, &lanes.logits],
        &lanes.colour_hidden,
    )?;
    Ok(work.then(net).then(light.colour(batch, lanes.colours())?))
}

fn words(array: &Array<u32>) -> Rows<'_> {
    Rows {
        part: array.into(),
        first: 0,
    }
}

/// Returns what kept samples take over from visited ones, and how many rows it has.
fn gathered(lanes: &Lanes, purpose: Purpose) -> Vec<(Rows<'_>, Rows<'_>, usize)> {
    let (from, to) = (&lanes.visited, &lanes.kept);
    let whole = |array: &Array<f32>| array.len() / lanes.capacity;
    let mut pairs = vec![
        (Rows::from(&from.along), Rows::from(&to.along), 3),
        (words(&from.ray_of), words(&to.ray_of), 1),
        ((&lanes.light[0]).into(), (&lanes.light[1]).into(), 3),
        ((&lanes.latent).into(), (&lanes.colour_in).into(), LATENT),
    ];
    if purpose == Purpose::Training {
        let [features, kept] = &lanes.features;
        pairs.push(((&from.xyz).into(), (&to.xyz).into(), 3));
        pairs.push((features.into(), kept.into(), whole(features)));
        let [hidden, kept] = &lanes.hidden;
        let layers = hidden.iter().zip(kept);
        pairs.extend(layers.map(|(hidden, kept)| (hidden.into(), kept.into(), whole(hidden))));
    }
    pairs
}

/// Returns how many numbers of a sample `gather` copies.
pub fn gathered_rows(lanes: &Lanes, purpose: Purpose) -> usize {
    gathered(lanes, purpose).iter().map(|(_, _, rows)| rows).sum()
}

/// Writes the number of rays to the uniforms of the walks of a batch.
pub fn write_walks(gpu: &Gpu, lanes: &Lanes, whole: Walk) {
    gpu.write(&lanes.walks[0], 0, &[whole]);
    gpu.write(&lanes.walks[1], 0, &[super::march::kept_walk(whole)]);
}

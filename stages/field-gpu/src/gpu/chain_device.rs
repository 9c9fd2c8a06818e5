//! A whole batch on the device, from features to gradients. The steps of the rays' kernels in between are
//! done here.

use marf_shaders::{Pace, Total, counts, found};

use super::array::Array;
use super::chain_tests::{CAPACITY, RAYS, SIZE, SLOTS, visited};
use super::light::{Aims, Colours, Columns, Light, RING, SlopeArrays, weights_of_losses};
use super::nets::{BACKGROUND, Back, KeptSamples, Layers, Nets, Rows};
use super::record::{Recorder, Work};
use super::rig::{Rig, blocks, columns};
use super::testing::aim;
use super::weights::layers;
use marf_field::Background;
use marf_field::batch::ChunkSums;
use marf_field::cpu::simd::{Block, flat};
use marf_field::draw::Target;
use marf_field::shade::Span;
use marf_field::training::Training;

/// What the device finds.
pub struct Trained {
    pub found: ChunkSums,
    /// Rows of `compare`.
    pub rows: Vec<f32>,
    pub features: Vec<f32>,
    pub kept: usize,
    pub total: Total,
}

fn spans_array(spans: &[[u32; 2]]) -> Vec<u32> {
    let mut array = vec![0; 2 * SLOTS];
    for (ray, [first, count]) in spans.iter().enumerate() {
        (array[ray], array[SLOTS + ray]) = (*first, *count);
    }
    array
}

/// Directions, targets of rays, pulls. Zeros in the slots without a ray.
fn aims(targets: &[Target]) -> (Vec<[f32; 4]>, Vec<marf_shaders::Target>, Vec<[f32; 2]>) {
    let directions = targets.iter().map(|target| match target.start {
        Some(start) => [start.direction[0], start.direction[1], start.direction[2], 1.0],
        None => [0.0; 4],
    });
    let pulls = targets
        .iter()
        .map(|target| target.pull.map_or([0.0; 2], |pull| [pull.place, pull.weight]));
    let (mut directions, mut pulls): (Vec<_>, Vec<_>) = (directions.collect(), pulls.collect());
    let mut aims: Vec<_> = targets.iter().map(aim).collect();
    directions.resize(SLOTS, [0.0; 4]);
    aims.resize(SLOTS, bytemuck::Zeroable::zeroed());
    pulls.resize(SLOTS, [0.0; 2]);
    (directions, aims, pulls)
}

/// The samples of the rays.
struct Samples {
    spans: Array<u32>,
    along: Array<f32>,
    light: Array<f32>,
}

struct Device<'a> {
    rig: &'a Rig,
    layers: Layers,
    nets: Nets,
    light: Light,
    weights: Array<f32>,
    all: Samples,
    /// Of visited samples.
    features: Array<f32>,
    ray_of: Array<u32>,
    /// Outputs of the density network, of visited samples.
    latent: Array<f32>,
    shown: Array<u32>,
    origin: Array<u32>,
    colours: Array<f32>,
    d_outputs: Array<f32>,
    directions: Array<[f32; 4]>,
    targets: Array<marf_shaders::Target>,
    pulls: Array<[f32; 2]>,
    gains: Array<[f32; 4]>,
    found: Array<f32>,
    work: Array<f32>,
    gradient: Array<f32>,
    slopes: Array<f32>,
    ring: Array<Total>,
}

/// Visited samples, encoded by the CPU.
fn samples(rig: &Rig, training: &Training, targets: &[Target]) -> (Samples, Array<f32>, Array<u32>) {
    let (shade, spans) = visited(training, targets);
    let width = training.state.weights.row_blocks() * 16;
    let mut along = vec![f32::NAN; 3 * CAPACITY];
    let rows = [&shade.samples.t, &shade.samples.delta, &shade.samples.place];
    for (row, values) in rows.into_iter().enumerate() {
        along[row * CAPACITY..][..values.len()].copy_from_slice(values);
    }
    rig.gpu
        .write(&rig.counts, 0, &[spans[RAYS - 1].end as u32, 0, RAYS as u32]);
    let counts_of = |span: &Span| [span.first as u32, (span.end - span.first) as u32];
    let spans: Vec<_> = spans.iter().map(counts_of).collect();
    let samples = Samples {
        spans: rig
            .gpu
            .filled("spans", &[spans_array(&spans), vec![0; 2 * SLOTS]].concat())
            .unwrap(),
        along: rig.filled(&along),
        light: rig.untouched(3),
    };
    let features = rig.filled(&columns(flat(&shade.features), width, CAPACITY, f32::NAN));
    let rays = spans.iter().zip(0..);
    let mut ray_of: Vec<u32> = rays
        .flat_map(|([_, count], ray)| (0..*count).map(move |_| ray))
        .collect();
    ray_of.resize(CAPACITY, 0);
    (samples, features, rig.gpu.filled("rays", &ray_of).unwrap())
}

impl<'a> Device<'a> {
    fn new(rig: &'a Rig, training: &Training, targets: &[Target]) -> Self {
        let weights = &training.state.weights;
        let zeros = |numbers: usize| rig.gpu.zeros::<f32>("numbers", numbers).unwrap();
        let words = |numbers: usize| rig.gpu.zeros::<u32>("words", numbers).unwrap();
        let (directions, aims, pulls) = aims(targets);
        let vectors = |values: &[[f32; 4]]| rig.gpu.filled("vectors", values).unwrap();
        let layers = layers(weights);
        let all = weights.density.layers.iter().chain(&weights.color.layers);
        let mut nets: Vec<f32> = all.flat_map(|layer| flat(&layer.weights)).copied().collect();
        nets.extend(&weights.background);
        nets.resize(layers.numbers(), 0.0);
        let (all, features, ray_of) = samples(rig, training, targets);
        Self {
            nets: Nets::new(&rig.gpu, &layers).unwrap(),
            light: Light::new(&rig.gpu).unwrap(),
            weights: rig.filled(&nets),
            all,
            features,
            ray_of,
            latent: zeros(16 * CAPACITY),
            shown: words(SIZE.shown_words()),
            origin: words(CAPACITY),
            colours: zeros(6 * CAPACITY),
            d_outputs: zeros(4 * CAPACITY),
            directions: vectors(&directions),
            targets: rig.gpu.filled("targets", &aims).unwrap(),
            pulls: rig.gpu.filled("pulls", &pulls).unwrap(),
            gains: vectors(&[[0.0; 4]; 3]),
            found: zeros(found::LEN * SLOTS),
            work: zeros(layers.work(CAPACITY, SLOTS)),
            gradient: zeros(layers.numbers()),
            slopes: zeros(layers.shapes[0][0] * CAPACITY),
            ring: rig.gpu.zeros("ring", RING).unwrap(),
            rig,
            layers,
        }
    }

    fn columns(&self) -> Columns<'_> {
        Columns {
            spans: &self.all.spans,
            along: &self.all.along,
            density: &self.latent,
            light: &self.all.light,
        }
    }

    /// The density network over all samples, then, by the CPU, the scan of the samples that show. Returns the
    /// samples kept.
    fn look(&self, most: u32) -> usize {
        let (rig, gpu) = (self.rig, &self.rig.gpu);
        let before = gpu.zeros("before", SLOTS).unwrap();
        let columns = self.columns();
        let (nets, weights) = (&self.nets, &self.weights);
        let density = nets.density(rig.batch(), weights, &self.features, &self.latent, Rows::All);
        let chosen = SIZE.extent(most);
        let chosen = gpu.uniform("chosen", chosen).unwrap();
        let opacity = self
            .light
            .opacity(rig.batch(), &chosen, columns, &before, &self.shown);
        self.record(&[density.unwrap(), opacity]);
        let (mut spans, mut kept) = (Vec::new(), 0);
        for count in &gpu.read(&self.shown).unwrap()[..RAYS] {
            spans.push([kept, *count]);
            kept += count;
        }
        gpu.write(&rig.counts, counts::KEPT as usize, &[kept]);
        gpu.write(&self.all.spans, 2 * SLOTS, &spans_array(&spans));
        let (spans, shown) = (&self.all.spans, &self.shown);
        let origin = self.light.kept(rig.batch(), spans, shown, &self.origin);
        self.record(&[origin.unwrap()]);
        kept as usize
    }

    /// Colours, loss and slopes in logits and raw densities.
    fn compare(&self, training: &Training) -> Vec<Work> {
        let (rig, light, batch) = (self.rig, &self.light, self.rig.batch());
        let (nets, weights) = (&self.nets, &self.weights);
        let shade = nets.shade(batch, weights, self.seen(), &self.latent, &self.colours);
        let colours = Colours::new(&self.colours);
        let columns = self.columns();
        let first = self.layers.behind(CAPACITY);
        let aims = Aims {
            directions: &self.directions,
            targets: &self.targets,
            gains: &self.gains,
            views: 3,
            background: Some(self.weights.part(self.layers.weights(), BACKGROUND)),
            found: &self.found,
            parts: self.work.part(first, self.work.len() - first),
        };
        let compare = light.compare(batch, columns, colours.rgb.clone(), aims);
        let losses = weights_of_losses(batch, training, training.state.steps);
        let losses = rig.gpu.uniform("losses", losses).unwrap();
        let slopes = SlopeArrays {
            found: &self.found,
            pulls: &self.pulls,
            d_outputs: &self.d_outputs,
        };
        let spread = light.spread(batch, &losses, columns, colours, slopes);
        vec![shade.unwrap(), compare.unwrap(), spread.unwrap()]
    }

    fn seen(&self) -> KeptSamples<'_> {
        KeptSamples {
            origin: &self.origin,
            ray_of: &self.ray_of,
            directions: &self.directions,
        }
    }

    /// Gradients of networks, features and background, and totals.
    fn backward(&self) -> Vec<Work> {
        let (light, batch, gpu, nets) = (&self.light, self.rig.batch(), &self.rig.gpu, &self.nets);
        let back = Back {
            features: &self.features,
            seen: self.seen(),
            weights: &self.weights,
            d_outputs: &self.d_outputs,
            work: &self.work,
            slopes: &self.slopes,
        };
        let pace = gpu.uniform("pace", Pace::default()).unwrap();
        let loss = self.found.part(found::LOSS * SLOTS, SLOTS);
        vec![
            nets.back(batch, back).unwrap(),
            nets.sum(batch, Background::Direction, &self.work, &self.gradient)
                .unwrap(),
            light.totals(batch, &pace, loss, &self.ring).unwrap(),
        ]
    }

    fn record(&self, runs: &[Work]) {
        let all = |recorder: &mut Recorder<'_>| runs.iter().for_each(|run| run.record(recorder));
        self.rig.gpu.submit(all);
    }

    /// Gradients of all layers, the density network's first, and of the background.
    fn gradients(&self) -> (Vec<Vec<Block>>, Vec<f32>) {
        let all = self.rig.gpu.read(&self.gradient).unwrap();
        let layers = self.layers.shapes.iter().zip(self.layers.firsts());
        let layers = layers.map(|([inputs, outputs], first)| blocks(&all[first..][..inputs * outputs]));
        (layers.collect(), all[self.layers.weights()..].to_vec())
    }
}

/// Trains on all rays up to the gradients.
pub fn on_the_device(rig: &Rig, training: &Training, targets: &[Target]) -> Trained {
    let device = Device::new(rig, training, targets);
    let kept = device.look(training.config.ray_samples);
    for runs in [device.compare(training), device.backward()] {
        device.record(&runs);
    }
    let read = |array: &Array<f32>| rig.gpu.read(array).unwrap();
    let (mut density, background) = device.gradients();
    let color = density.split_off(device.layers.density);
    Trained {
        found: ChunkSums {
            density,
            color,
            background,
            ..ChunkSums::default()
        },
        rows: read(&device.found),
        features: read(&device.slopes),
        kept,
        total: rig.gpu.read(&device.ring).unwrap()[0],
    }
}

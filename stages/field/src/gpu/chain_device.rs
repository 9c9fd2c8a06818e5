//! A whole batch on the device, from features to gradients; what the rays' kernels do in between is done here.

use marf_shaders::{Pace, Total, counts, faults, found};

use super::array::Array;
use super::chain_net::OnDevice;
use super::chain_tests::{CAPACITY, RAYS, SLOTS, visited};
use super::light::{Aims, Colours, Columns, Light, RING, weights_of_losses};
use super::nets::{Gradient, Nets, Rows};
use super::record::{Recorder, Work};
use super::rig::{Rig, blocks, columns};
use crate::batch::Found;
use crate::cpu::simd::{Block, flat};
use crate::draw::Target;
use crate::shade::Span;
use crate::training::Training;

/// What the device finds.
pub struct Trained {
    pub found: Found,
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

/// Directions, pixels with views, pulls.
fn aims(targets: &[Target]) -> ([Vec<[f32; 4]>; 2], Vec<[f32; 2]>) {
    let directions = targets.iter().map(|target| match target.start {
        Some(start) => [start.direction[0], start.direction[1], start.direction[2], 1.0],
        None => [0.0; 4],
    });
    let pixels = targets.iter().map(|target| {
        let [r, g, b] = target.rgb;
        [r, g, b, f32::from_bits(target.view)]
    });
    let pulls = targets
        .iter()
        .map(|target| target.pull.map_or([0.0; 2], |pull| [pull.place, pull.weight]));
    let (mut lists, mut pulls) = (
        [directions.collect(), pixels.collect()],
        pulls.collect::<Vec<_>>(),
    );
    lists
        .iter_mut()
        .for_each(|list: &mut Vec<_>| list.resize(SLOTS, [0.0; 4]));
    pulls.resize(SLOTS, [0.0; 2]);
    (lists, pulls)
}

/// The samples of the rays before or after hidden ones are dropped.
struct Samples {
    spans: Array<u32>,
    along: Array<f32>,
    light: Array<f32>,
    features: Array<f32>,
}

struct Device<'a> {
    rig: &'a Rig,
    nets: Nets,
    light: Light,
    density: OnDevice,
    color: OnDevice,
    /// Features of a sample.
    width: usize,
    all: Samples,
    kept: Samples,
    ray_of: Array<u32>,
    /// Kept activations of the density network's hidden layer.
    hidden: Array<f32>,
    latent: Array<f32>,
    rgb: Array<f32>,
    d_logits: Array<f32>,
    directions: Array<[f32; 4]>,
    pixels: Array<[f32; 4]>,
    pulls: Array<[f32; 2]>,
    gains: Array<[f32; 4]>,
    background: Array<f32>,
    found: Array<f32>,
    of_rays: Array<f32>,
    d_background: Array<f32>,
    parts: Array<f32>,
    ring: Array<Total>,
}

/// Visited samples, encoded by the CPU.
fn samples(rig: &Rig, training: &Training, targets: &[Target]) -> Samples {
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
    Samples {
        spans: rig.gpu.filled("spans", &spans_array(&spans)).unwrap(),
        along: rig.filled(&along),
        light: rig.untouched(3),
        features: rig.filled(&columns(flat(&shade.features), width, CAPACITY, f32::NAN)),
    }
}

impl<'a> Device<'a> {
    fn new(rig: &'a Rig, training: &Training, targets: &[Target]) -> Self {
        let weights = &training.state.weights;
        let zeros = |numbers: usize| rig.gpu.zeros::<f32>("numbers", numbers).unwrap();
        let words = |numbers: usize| rig.gpu.zeros::<u32>("words", numbers).unwrap();
        let width = weights.row_blocks() * 16;
        let ([directions, pixels], pulls) = aims(targets);
        let vectors = |values: &[[f32; 4]]| rig.gpu.filled("vectors", values).unwrap();
        Self {
            nets: Nets::new(&rig.gpu).unwrap(),
            light: Light::new(&rig.gpu).unwrap(),
            density: OnDevice::new(rig, &weights.density),
            color: OnDevice::new(rig, &weights.color),
            all: samples(rig, training, targets),
            kept: Samples {
                spans: words(2 * SLOTS),
                along: zeros(3 * CAPACITY),
                light: zeros(3 * CAPACITY),
                features: zeros(width * CAPACITY),
            },
            ray_of: words(CAPACITY),
            hidden: zeros(weights.density.layers[0].outputs * CAPACITY),
            latent: zeros(16 * weights.color_blocks() * CAPACITY),
            rgb: zeros(3 * CAPACITY),
            d_logits: zeros(16 * CAPACITY),
            directions: vectors(&directions),
            pixels: vectors(&pixels),
            pulls: rig.gpu.filled("pulls", &pulls).unwrap(),
            gains: vectors(&[[0.0; 4]; 3]),
            background: rig.filled(&weights.background),
            found: zeros(found::LEN * SLOTS),
            of_rays: zeros(16 * SLOTS),
            d_background: zeros(64),
            parts: zeros(Gradient::parts(CAPACITY, [64, 64])),
            ring: rig.gpu.zeros("ring", RING).unwrap(),
            rig,
            width,
        }
    }

    fn columns<'b>(samples: &'b Samples, density: &'b Array<f32>) -> Columns<'b> {
        Columns {
            spans: &samples.spans,
            along: &samples.along,
            density,
            light: &samples.light,
        }
    }

    /// The density network over all samples; then, by the CPU, the scan of what shows. Returns the samples kept.
    fn look(&self) -> usize {
        let (rig, gpu) = (self.rig, &self.rig.gpu);
        let before = gpu.zeros("before", SLOTS).unwrap();
        let shown = gpu.zeros::<u32>("shown", 2 * SLOTS).unwrap();
        let columns = Self::columns(&self.all, self.density.output());
        let mut runs = self
            .density
            .forward(rig, &self.nets, counts::VISITED, &self.all.features);
        let opacity = self
            .light
            .opacity(rig.batch(), counts::RAYS, columns, &before, &shown);
        runs.push(opacity.unwrap());
        self.record(&runs);
        let (mut spans, mut ray_of) = (Vec::new(), Vec::new());
        for (ray, count) in (0..).zip(&gpu.read(&shown).unwrap()[..RAYS]) {
            spans.push([ray_of.len() as u32, *count]);
            ray_of.extend((0..*count).map(|_| ray));
        }
        gpu.write(&rig.counts, counts::KEPT as usize, &[ray_of.len() as u32]);
        gpu.write(&self.ray_of, 0, &ray_of);
        gpu.write(&self.kept.spans, 0, &spans_array(&spans));
        ray_of.len()
    }

    /// Drops what is hidden.
    fn keep(&self) -> Vec<Work> {
        let (batch, all, kept) = (self.rig.batch(), &self.all, &self.kept);
        let origin = self.rig.gpu.zeros("origin", CAPACITY).unwrap();
        let spans = [&all.spans, &kept.spans];
        let mut runs = vec![self.light.kept(batch, counts::RAYS, spans, &origin).unwrap()];
        for (from, to, rows) in [
            (&all.along, &kept.along, 3),
            (&all.light, &kept.light, 3),
            (&all.features, &kept.features, self.width),
            (&self.density.outputs[0], &self.hidden, self.density.shapes[0][1]),
            (self.density.output(), &self.latent, 16),
        ] {
            let gather = self.light.gather(batch, &origin, from.into(), to.into(), rows);
            runs.push(gather.unwrap());
        }
        runs
    }

    /// Colours, loss and slopes in logits and raw densities.
    fn compare(&self, training: &Training) -> Vec<Work> {
        let (rig, light, batch) = (self.rig, &self.light, self.rig.batch());
        let to = Rows {
            part: (&self.latent).into(),
            first: 16,
        };
        let mut runs = vec![
            light
                .harmonics(batch, &self.directions, &self.ray_of, to)
                .unwrap(),
        ];
        runs.extend(self.color.forward(rig, &self.nets, counts::KEPT, &self.latent));
        let colours = Colours {
            logits: self.color.output(),
            rgb: &self.rgb,
        };
        let columns = Self::columns(&self.kept, &self.latent);
        let aims = Aims {
            directions: &self.directions,
            targets: &self.pixels,
            gains: &self.gains,
            views: 3,
            background: Some(&self.background),
            found: &self.found,
        };
        runs.push(light.colour(batch, colours).unwrap());
        runs.push(light.compare(batch, columns, &self.rgb, aims).unwrap());
        let losses = weights_of_losses(batch, &training.config, &training.march);
        let losses = rig.gpu.uniform("losses", losses).unwrap();
        let to = [&self.found, &self.d_logits];
        let spread = light.spread(batch, &losses, (columns, colours), to, &self.pulls);
        runs.push(spread.unwrap());
        runs
    }

    /// Gradients of both networks and of the features.
    fn backward(&self) -> Vec<Work> {
        let (rig, light, batch) = (self.rig, &self.light, self.rig.batch());
        let (density, color) = (&self.density, &self.color);
        let from = (&self.latent, color.outputs.as_slice());
        let mut runs = color.backward(rig, &self.nets, from, &self.d_logits, &self.parts);
        let slope = &color.slopes[0];
        runs.push(light.join(batch, &self.kept.light, slope).unwrap());
        let from = (&self.kept.features, std::slice::from_ref(&self.hidden));
        runs.extend(density.backward(rig, &self.nets, from, slope, &self.parts));
        let features = &density.slopes[0];
        runs.push(
            light
                .runaway(batch, features, self.width, faults::FEATURES)
                .unwrap(),
        );
        runs
    }

    /// The gradient of the background, and totals.
    fn rays(&self) -> Vec<Work> {
        let (light, batch, gpu) = (&self.light, self.rig.batch(), &self.rig.gpu);
        let gradient = Gradient {
            a: (&self.found).into(),
            d: (&self.of_rays).into(),
            shape: [4, 16],
            capacity: SLOTS,
            parts: (&self.parts).into(),
            gradient: (&self.d_background).into(),
            fault: faults::BACKGROUND,
        };
        let pace = gpu.uniform("pace", Pace::default()).unwrap();
        let loss = self.found.part(found::LOSS * SLOTS, SLOTS);
        let mut runs = vec![
            light
                .harmonics_of_rays(batch, &self.directions, &self.of_rays)
                .unwrap(),
        ];
        runs.push(self.nets.gradient(batch, counts::RAYS, gradient).unwrap());
        runs.push(light.totals(batch, &pace, loss, &self.ring).unwrap());
        runs
    }

    fn record(&self, runs: &[Work]) {
        let all = |recorder: &mut Recorder<'_>| runs.iter().for_each(|run| run.record(recorder));
        self.rig.gpu.submit(all);
    }

    fn gradients(&self, net: &OnDevice) -> Vec<Vec<Block>> {
        let layers = net.gradients.iter();
        layers
            .map(|layer| blocks(&self.rig.gpu.read(layer).unwrap()))
            .collect()
    }
}

/// Trains on all rays up to the gradients.
pub fn on_the_device(rig: &Rig, training: &Training, targets: &[Target]) -> Trained {
    let device = Device::new(rig, training, targets);
    let kept = device.look();
    for runs in [
        device.keep(),
        device.compare(training),
        device.backward(),
        device.rays(),
    ] {
        device.record(&runs);
    }
    let read = |array: &Array<f32>| rig.gpu.read(array).unwrap();
    Trained {
        found: Found {
            density: device.gradients(&device.density),
            color: device.gradients(&device.color),
            background: read(&device.d_background),
            ..Found::default()
        },
        rows: read(&device.found),
        features: read(&device.density.slopes[0]),
        kept,
        total: rig.gpu.read(&device.ring).unwrap()[0],
    }
}

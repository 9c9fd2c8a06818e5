//! A batch in chunks of rays: samples, features, loss, and all gradients but those of the tables.

use parking_lot::Mutex;
use rayon::prelude::*;

use crate::cpu::composite::{Gathered, RAW_LIMIT, Ray, Runaways, colour, colour_slope, runs_away};
use crate::cpu::encode::Points;
use crate::cpu::march::{Bits, March, Samples, Steps};
use crate::cpu::simd::{Block, InstructionSet, Isa, Kernel, LANES, Run, Stripe, flat};
use crate::draw::Target;
use crate::exposure::Exposure;
use crate::shade::{Shade, Span, lookup};
use crate::weights::Weights;
use crate::{Background, Config, sh};

/// What all chunks of a step share.
#[derive(Clone, Copy)]
pub struct Shared<'a> {
    /// Instruction set.
    pub level: InstructionSet,
    /// Hyper-parameters.
    pub config: &'a Config,
    /// The weights.
    pub weights: &'a Weights,
    /// Where rays are looked at.
    pub steps: &'a Steps,
    /// What is occupied.
    pub bits: &'a Bits,
    /// Rays of the whole batch: gradients are those of the mean.
    pub rays: usize,
}

/// Rays that are trained together. Its memory is kept from step to step.
#[derive(Default)]
pub struct Chunk {
    /// Samples on the rays, padded to a multiple of 16; after training those that were trained.
    pub samples: Samples,
    /// Encoded features of the samples; after training their gradients.
    pub features: Vec<Block>,
    spans: Vec<Span>,
    harmonics: Vec<[f32; sh::COUNT]>,
    /// What training found.
    pub found: Found,
}

/// What a chunk found beside the gradients of its features.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Gradients of the density network's layers.
    pub density: Vec<Vec<Block>>,
    /// Gradients of the colour network's layers.
    pub color: Vec<Vec<Block>>,
    /// Gradient of the background, `[3, 16]`.
    pub background: Vec<f32>,
    /// Gradients of the exposures, photo by photo as the rays come.
    pub exposures: Vec<(u32, Exposure)>,
    /// Sum of squared errors over rays and channels.
    pub loss: f64,
    /// Samples that rays visited.
    pub visited: u64,
    /// Samples that were trained.
    pub samples: u64,
    /// First tensor with a number that ran away.
    pub bad: Option<&'static str>,
}

impl Found {
    /// Returns the first gradient, but those of the features, with a number that runs away.
    pub fn runaway_gradient(&self) -> Option<&'static str> {
        let wild = |values: &[f32]| values.iter().any(|value| runs_away(*value));
        let mut layers = self.density.iter().chain(&self.color);
        match () {
            () if layers.any(|layer| wild(flat(layer))) => Some("gradient of the networks"),
            () if wild(&self.background) => Some("gradient of the background"),
            () if self
                .exposures
                .iter()
                .any(|(_, slope)| wild(&slope.gain) || wild(&slope.offset)) =>
            {
                Some("gradient of the exposures")
            }
            () => None,
        }
    }
}

/// Memory of the workers; a worker takes one and gives it back.
pub type Spares = Mutex<Vec<Scratch>>;

/// Memory of one worker.
#[derive(Default)]
pub struct Scratch {
    shade: Shade,
    kept: Vec<u32>,
    before: Vec<f32>,
    d_tau: Vec<f32>,
    d_rgb: Vec<[f32; 4]>,
    slope: Vec<Block>,
    spare: Vec<Block>,
}

/// Trains on a batch, `rays` rays a chunk; fills `chunks`.
///
/// Features are looked up level by level over the whole batch: the cache then holds one table, not all.
pub fn train(shared: &Shared, targets: &[Target], rays: usize, chunks: &mut Vec<Chunk>, spares: &Spares) {
    chunks.resize_with(targets.len().div_ceil(rays), Chunk::default);
    let pairs = chunks.par_iter_mut().zip(targets.par_chunks(rays));
    pairs.for_each(|(chunk, targets)| chunk.march(shared, targets));
    encode(shared, chunks);
    let pairs = chunks.par_iter_mut().zip(targets.par_chunks(rays));
    pairs.with_max_len(1).for_each(|(chunk, targets)| {
        let mut scratch = spares.lock().pop().unwrap_or_default();
        scratch.train(shared, targets, chunk);
        spares.lock().push(scratch);
    });
}

/// Looks up the features of all chunks: one task a level and chunk, level by level.
fn encode(shared: &Shared, chunks: &mut [Chunk]) {
    let weights = shared.weights;
    let levels = weights.shapes.iter().zip(&weights.tables);
    let mut tasks: Vec<Vec<(Points, Stripe)>> = levels.clone().map(|_| Vec::new()).collect();
    for chunk in chunks {
        let points = chunk.samples.points();
        let stripes = Stripe::cut(&mut chunk.features, weights.row_blocks(), weights.features);
        for (tasks, stripe) in tasks.iter_mut().zip(stripes) {
            tasks.push((points, stripe));
        }
    }
    let tasks = levels.zip(tasks).flat_map(|((shape, table), tasks)| {
        let one = move |(points, stripe)| (*shape, table.as_slice(), points, stripe);
        tasks.into_iter().map(one)
    });
    let tasks: Vec<_> = tasks.collect();
    tasks
        .into_par_iter()
        .with_min_len(4)
        .for_each(|(shape, table, points, stripe)| {
            lookup(shared.level, weights.features, shape, table, points, stripe);
        });
}

impl Chunk {
    /// Collects the samples of every ray.
    fn march(&mut self, shared: &Shared, targets: &[Target]) {
        self.samples.resize(0);
        self.spans.clear();
        self.harmonics.clear();
        for target in targets {
            let first = self.samples.len();
            let mut harmonics = [0.0; sh::COUNT];
            if let Some(start) = target.start {
                harmonics = sh::harmonics(start.direction);
                shared.level.run(March {
                    steps: shared.steps,
                    bits: shared.bits,
                    origin: start.origin,
                    direction: start.direction,
                    jitter: target.jitter,
                    first: 0,
                    limit: usize::MAX,
                    samples: &mut self.samples,
                });
            }
            let end = self.samples.len();
            self.spans.push(Span { first, end });
            self.harmonics.push(harmonics);
        }
        self.found.visited = self.samples.len() as u64;
        let padded = self.samples.len().next_multiple_of(LANES);
        self.samples.resize(padded);
        let rows = padded * shared.weights.row_blocks();
        self.features.resize(rows, Block::default());
    }
}

impl Scratch {
    /// Trains on the rays of a chunk whose features have been looked up.
    fn train(&mut self, shared: &Shared, targets: &[Target], chunk: &mut Chunk) {
        std::mem::swap(&mut self.shade.samples, &mut chunk.samples);
        std::mem::swap(&mut self.shade.features, &mut chunk.features);
        chunk.found.bad = self.learn(shared, targets, chunk).err();
        std::mem::swap(&mut self.shade.samples, &mut chunk.samples);
        std::mem::swap(&mut self.slope, &mut chunk.features);
    }

    /// # Errors
    /// The first tensor with a number that runs away.
    fn learn(&mut self, shared: &Shared, targets: &[Target], chunk: &mut Chunk) -> Result<(), &'static str> {
        self.shade.infer(shared.level, shared.weights);
        if shared.level.run(Runaways(&self.shade.raw)) > 0 {
            return Err("raw density");
        }
        self.before.resize(targets.len(), 0.0);
        self.shade.opacities(shared.level, &chunk.spans, &self.before);
        self.shade.drop_hidden(&mut chunk.spans, &mut self.kept);
        self.shade
            .colours(shared.level, shared.weights, &chunk.spans, &chunk.harmonics);
        let logits = self.shade.color.last().map_or(&[][..], Vec::as_slice);
        if shared.level.run(Runaways(flat(logits))) > 0 {
            return Err("colour logits");
        }
        chunk.found.samples = self.kept.len() as u64;
        self.losses(shared, targets, chunk);
        if !chunk.found.loss.is_finite() {
            return Err("loss");
        }
        self.backward(shared, &mut chunk.found);
        if shared.level.run(Runaways(flat(&self.slope))) > 0 {
            return Err("gradient of the features");
        }
        Ok(())
    }

    /// Compares every ray with its pixel and sends the difference back to densities, colours, background, gain.
    fn losses(&mut self, shared: &Shared, targets: &[Target], chunk: &mut Chunk) {
        let n = self.shade.raw.len();
        self.d_tau.clear();
        self.d_tau.resize(n, 0.0);
        self.d_rgb.clear();
        self.d_rgb.resize(n, [0.0; 4]);
        let found = &mut chunk.found;
        found.loss = 0.0;
        found.exposures.clear();
        found.background.clear();
        found.background.resize(3 * sh::COUNT, 0.0);
        shared.level.run(Losses {
            shared,
            targets,
            spans: &chunk.spans,
            harmonics: &chunk.harmonics,
            shade: &self.shade,
            d_tau: &mut self.d_tau,
            d_rgb: &mut self.d_rgb,
            found,
        });
    }

    /// Carries the gradients through both networks to the features.
    fn backward(&mut self, shared: &Shared, found: &mut Found) {
        let (shade, weights) = (&mut self.shade, shared.weights);
        let n = shade.raw.len();
        let logits = shade.color.last().map_or(&[][..], Vec::as_slice);
        self.slope.clear();
        self.slope.resize(n, Block::default());
        for (index, slope) in self.slope.iter_mut().enumerate() {
            for channel in 0..3 {
                let (logit, value) = (logits[index].0[channel], shade.rgb[index][channel]);
                slope.0[channel] = self.d_rgb[index][channel] * colour_slope(logit, value);
            }
        }
        weights.color.shape_gradients(&mut found.color);
        let (slope, spare) = (&mut self.slope, &mut self.spare);
        weights.color.backward(
            shared.level,
            &shade.latent,
            &shade.color,
            slope,
            spare,
            &mut found.color,
        );
        let blocks = weights.color_blocks();
        for index in 0..n {
            let mut row = slope[blocks * index];
            if shade.raw[index] < RAW_LIMIT {
                row.0[0] = self.d_tau[index].mul_add(shade.tau[index], row.0[0]);
            }
            slope[index] = row;
        }
        slope.truncate(n);
        weights.density.shape_gradients(&mut found.density);
        weights.density.backward(
            shared.level,
            &shade.features,
            &shade.density,
            slope,
            spare,
            &mut found.density,
        );
    }
}

/// The loss of every ray and its gradients.
struct Losses<'a> {
    shared: &'a Shared<'a>,
    targets: &'a [Target],
    spans: &'a [Span],
    harmonics: &'a [[f32; sh::COUNT]],
    shade: &'a Shade,
    d_tau: &'a mut [f32],
    d_rgb: &'a mut [[f32; 4]],
    found: &'a mut Found,
}

impl Kernel for Losses<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(mut self, _isa: I) {
        let rays = self.targets.iter().zip(self.spans).zip(self.harmonics);
        for ((target, span), harmonics) in rays.filter(|((target, _), _)| target.start.is_some()) {
            self.ray(target, *span, harmonics);
        }
    }
}

impl Losses<'_> {
    #[inline(always)]
    fn ray(&mut self, target: &Target, Span { first, end }: Span, harmonics: &[f32; sh::COUNT]) {
        let (shared, shade) = (self.shared, self.shade);
        let ray = Ray {
            alpha: &shade.alpha[first..end],
            transmittance: &shade.transmittance[first..end],
            rgb: &shade.rgb[first..end],
            place: &shade.samples.place[first..end],
        };
        let Gathered { rgb, left } = ray.gather();
        let logits = shared.weights.logits_behind(harmonics);
        let behind = shared.weights.behind(shared.config.background, harmonics);
        let scale = 2.0 / (3 * shared.rays) as f32;
        let plain = [0, 1, 2].map(|channel| left.mul_add(behind[channel], rgb[channel]));
        let compared = target.exposure.compare(plain, target.rgb, scale);
        let slope = compared.colour;
        for square in compared.squares {
            self.found.loss += f64::from(square);
        }
        let strength = shared.config.distortion as f32 / shared.rays as f32;
        let cell = 1.0 / shared.steps.count as f32;
        let (d_tau, d_rgb) = (&mut self.d_tau[first..end], &mut self.d_rgb[first..end]);
        ray.spread(slope, behind, [strength, cell], d_tau, d_rgb);
        // The slope of an opacity in its optical depth is what it lets pass.
        let emptiness = shared.config.emptiness as f32 / shared.rays as f32;
        for (slope, alpha) in d_tau.iter_mut().zip(ray.alpha) {
            *slope = emptiness.mul_add(1.0 - alpha, *slope);
        }
        if let Some(pull) = target.pull {
            pull.spread(&ray, cell, d_tau);
        }
        self.found.exposures.push((target.view, compared.exposure));
        if shared.config.background == Background::Direction {
            self.behind(slope.map(|slope| left * slope), logits, harmonics);
        }
    }

    /// Sends the gradient of the background's colour to its coefficients.
    #[inline(always)]
    fn behind(&mut self, slope: [f32; 3], logits: [f32; 3], harmonics: &[f32; sh::COUNT]) {
        for channel in 0..3 {
            let d_logit = slope[channel] * colour_slope(logits[channel], colour(logits[channel]));
            let row = &mut self.found.background[channel * sh::COUNT..][..sh::COUNT];
            for (gradient, harmonic) in row.iter_mut().zip(harmonics) {
                *gradient = d_logit.mul_add(*harmonic, *gradient);
            }
        }
    }
}

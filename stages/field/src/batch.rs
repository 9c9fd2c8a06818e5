//! A batch in chunks of rays: samples, features, loss, and all gradients but those of the tables.

use parking_lot::Mutex;
use rayon::prelude::*;

use crate::cpu::composite::{Densities, Runaways};
use crate::cpu::encode::{Points, warm};
use crate::cpu::march::{March, Samples};
use crate::cpu::net::Slopes;
use crate::cpu::simd::{Block, InstructionSet, LANES, Run, Stripe, flat};
use crate::draw::Target;
pub use crate::losses::{ChunkSums, StepContext};
use crate::losses::{LogitSlopes, Losses, RawSlopes};
use crate::occupancy::Probe;
use crate::planes::{GridLevel, ToPlanes, planes_mut};
use crate::sh;
use crate::shade::{Shade, Span};
use crate::weights::Weights;

/// Rays that are trained together. Its memory is kept from step to step.
#[derive(Default)]
pub struct Chunk {
    /// Samples on the rays, padded to a multiple of 16. After training: the trained ones.
    pub samples: Samples,
    /// Encoded features of the samples, `[levels, n, F]`. After training: their gradients.
    pub features: Vec<Block>,
    spans: Vec<Span>,
    harmonics: Vec<[f32; sh::COUNT]>,
    /// What training found.
    pub found: ChunkSums,
}

/// Memory of the workers. A worker takes one and gives it back.
pub type Spares = Mutex<Vec<Scratch>>;

/// Memory of one worker.
#[derive(Default)]
pub struct Scratch {
    shade: Shade,
    kept: Vec<u32>,
    before: Vec<f32>,
    d_tau: Vec<f32>,
    d_rgb: Vec<[f32; 4]>,
    /// Gradients of the colour network's outputs, then of the density network's, then of the features.
    slopes: Slopes,
}

/// Points of a chunk, and of as many chunks as are looked up together: their features then take no more memory than those
/// of a batch.
const CHUNK_PROBES: usize = 1024;
const PROBES: usize = 32 * CHUNK_PROBES;

/// Trains on a batch, `rays` rays a chunk, and fills `chunks`.
///
/// Features are looked up level by level over the whole batch: the cache then holds one table, not all.
pub fn train(
    shared: &StepContext,
    targets: &[Target],
    rays: usize,
    chunks: &mut Vec<Chunk>,
    spares: &Spares,
) {
    chunks.resize_with(targets.len().div_ceil(rays), Chunk::default);
    let pairs = chunks.par_iter_mut().zip(targets.par_chunks(rays));
    pairs.for_each(|(chunk, targets)| chunk.march(shared, targets));
    encode(shared.level, shared.weights, chunks);
    let pairs = chunks.par_iter_mut().zip(targets.par_chunks(rays));
    pairs.with_max_len(1).for_each(|(chunk, targets)| {
        let mut scratch = spares.lock().pop().unwrap_or_default();
        scratch.train(shared, targets, chunk);
        spares.lock().push(scratch);
    });
}

/// Tasks a thread of the lookup, at least: levels differ in what they cost.
const TASKS: usize = 8;

/// Looks up the features of all chunks, level by level: a task is a level for some chunks.
fn encode(level: InstructionSet, weights: &Weights, chunks: &mut [Chunk]) {
    let levels = weights.shapes.len().max(1);
    let tasks = (TASKS * rayon::current_num_threads()).div_ceil(levels);
    let group = chunks.len().div_ceil(tasks).max(1);
    let mut rows: Vec<Vec<(Points, Stripe)>> = weights.shapes.iter().map(|_| Vec::new()).collect();
    for chunk in chunks {
        let points = chunk.samples.points();
        for (rows, plane) in rows.iter_mut().zip(planes_mut(&mut chunk.features, weights)) {
            rows.push((points, Stripe::plane(plane, weights.features)));
        }
    }
    let tables = weights.shapes.par_iter().zip(&weights.tables);
    tables.zip(rows).for_each(|((shape, table), rows)| {
        rows.into_par_iter().chunks(group).for_each(|rows| {
            warm(table);
            for (points, stripe) in rows {
                let grid = GridLevel::new(weights.features, *shape, table);
                grid.lookup(level, points, stripe);
            }
        });
    });
}

/// Returns the densities at probes of the occupancy, NaN where one is not finite. `chunks`: memory.
pub fn densities(
    level: InstructionSet,
    weights: &Weights,
    probes: &[Probe],
    chunks: &mut Vec<Chunk>,
    spares: &Spares,
) -> Vec<f32> {
    let mut found = vec![0.0; probes.len()];
    for (probes, found) in probes.chunks(PROBES).zip(found.chunks_mut(PROBES)) {
        chunks.resize_with(probes.len().div_ceil(CHUNK_PROBES), Chunk::default);
        let pairs = chunks.par_iter_mut().zip(probes.par_chunks(CHUNK_PROBES));
        pairs.for_each(|(chunk, probes)| chunk.place(weights, probes));
        encode(level, weights, chunks);
        let pairs = chunks.par_iter().zip(found.par_chunks_mut(CHUNK_PROBES));
        pairs.for_each(|(chunk, found)| {
            let mut scratch = spares.lock().pop().unwrap_or_default();
            scratch.shade.infer(level, weights, &chunk.features);
            let raw = &scratch.shade.raw;
            level.run(Densities { raw, found });
            spares.lock().push(scratch);
        });
    }
    found
}

impl Chunk {
    /// Takes points to look at.
    fn place(&mut self, weights: &Weights, probes: &[Probe]) {
        let samples = &mut self.samples;
        samples.resize(0);
        for (axis, numbers) in [&mut samples.x, &mut samples.y, &mut samples.z]
            .into_iter()
            .enumerate()
        {
            numbers.extend(probes.iter().map(|probe| probe.at[axis]));
        }
        self.pad(weights);
    }

    /// Fills the last vector, and makes room for the features.
    fn pad(&mut self, weights: &Weights) {
        let padded = self.samples.len().next_multiple_of(LANES);
        self.samples.resize(padded);
        self.features
            .resize(padded * weights.row_blocks(), Block::default());
    }

    /// Collects the samples of every ray.
    fn march(&mut self, shared: &StepContext, targets: &[Target]) {
        self.samples.resize(0);
        self.spans.clear();
        self.harmonics.clear();
        for target in targets {
            let first = self.samples.len();
            let mut harmonics = [0.0; sh::COUNT];
            if let Some(start) = target.start {
                harmonics = sh::harmonics(start.direction);
                shared.level.run(March {
                    clearance: Some(shared.clearance),
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
        self.pad(shared.weights);
    }
}

impl Scratch {
    /// Trains on the rays of a chunk whose features have been looked up.
    fn train(&mut self, shared: &StepContext, targets: &[Target], chunk: &mut Chunk) {
        std::mem::swap(&mut self.shade.samples, &mut chunk.samples);
        chunk.found.bad = self.learn(shared, targets, chunk).err();
        std::mem::swap(&mut self.shade.samples, &mut chunk.samples);
    }

    /// # Errors
    /// The first tensor with a number that runs away.
    fn learn(
        &mut self,
        shared: &StepContext,
        targets: &[Target],
        chunk: &mut Chunk,
    ) -> Result<(), &'static str> {
        let weights = shared.weights;
        self.shade.infer(shared.level, weights, &chunk.features);
        if shared.level.run(Runaways(&self.shade.raw)) {
            return Err("raw density");
        }
        self.opacities(shared, targets, chunk);
        self.shade
            .colours(shared.level, weights, &chunk.spans, &chunk.harmonics);
        let logits = self.shade.color.last().map_or(&[][..], Vec::as_slice);
        if shared.level.run(Runaways(flat(logits))) {
            return Err("colour logits");
        }
        self.losses(shared, targets, chunk);
        if !chunk.found.loss.is_finite() {
            return Err("loss");
        }
        self.colour_backward(shared, &mut chunk.found);
        self.density_backward(shared, chunk)?;
        chunk.found.runaway_gradient(shared.level).map_or(Ok(()), Err)
    }

    /// Turns densities into opacities and decides which samples are trained.
    fn opacities(&mut self, shared: &StepContext, targets: &[Target], chunk: &mut Chunk) {
        self.before.resize(targets.len(), 0.0);
        let (shade, before, kept) = (&mut self.shade, &self.before, &mut self.kept);
        shade.opacities(shared.level, &chunk.spans, before);
        shade.choose(shared.ray_samples, &chunk.spans, kept);
        shade.keep(&mut chunk.spans, kept);
        if shared.ray_samples > 0 {
            // Lengths have changed.
            shade.opacities(shared.level, &chunk.spans, before);
        }
        chunk.found.samples = kept.len() as u64;
    }

    /// Compares every ray with its pixel and sends the difference back to densities, colours, background, gain.
    fn losses(&mut self, shared: &StepContext, targets: &[Target], chunk: &mut Chunk) {
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

    /// Carries the gradients of colours through their network, to the outputs of the density network.
    fn colour_backward(&mut self, shared: &StepContext, found: &mut ChunkSums) {
        let (shade, weights) = (&self.shade, shared.weights);
        self.slopes.rows.resize(shade.rgb.len(), Block::ZERO);
        shared.level.run(LogitSlopes {
            logits: shade.color.last().map_or(&[][..], Vec::as_slice),
            rgb: &shade.rgb,
            d_rgb: &self.d_rgb,
            slopes: &mut self.slopes.rows,
        });
        weights.color.shape_gradients(&mut found.color);
        weights.color.backward(
            shared.level,
            &shade.latent,
            &shade.color,
            &mut self.slopes,
            &mut found.color,
        );
    }

    /// Carries the gradients of raw densities and latents to the features.
    ///
    /// # Errors
    /// Those of the features, with a number that runs away.
    fn density_backward(&mut self, shared: &StepContext, chunk: &mut Chunk) -> Result<(), &'static str> {
        let (shade, weights, found) = (&self.shade, shared.weights, &mut chunk.found);
        shared.level.run(RawSlopes {
            shade,
            d_tau: &self.d_tau,
            slopes: &mut self.slopes.rows,
        });
        weights.density.shape_gradients(&mut found.density);
        weights.density.backward(
            shared.level,
            &shade.features,
            &shade.density,
            &mut self.slopes,
            &mut found.density,
        );
        let slope = &self.slopes.rows;
        if shared.level.run(Runaways(flat(slope))) {
            return Err("gradient of the features");
        }
        chunk.features.resize(slope.len(), Block::default());
        shared.level.run(ToPlanes {
            rows: slope,
            planes: &mut chunk.features,
            features: weights.features,
            levels: weights.shapes.len(),
        });
        Ok(())
    }
}

//! The CPU as a backend: the same bytes for any number of threads and on every instruction set.

use std::ops::Range;
use std::sync::Arc;

use marf_scene::{Camera, Pose};
use rayon::prelude::*;

use crate::FieldError;
use crate::backend::{Backend, Renderer, Session, Step};
use crate::batch::{self, Chunk, Shared, Spares};
use crate::cpu::composite::{RAW_SHIFT, runs_away};
use crate::cpu::math::exp;
use crate::cpu::simd::InstructionSet;
use crate::learn::learn;
use crate::model::Model;
use crate::picture::Render;
use crate::render::render_rows;
use crate::schedule::UPDATE_EVERY;
use crate::shade::Shade;
use crate::state::State;
use crate::training::Training;

/// Trains and renders on the CPU.
#[derive(Clone, Copy, Debug)]
pub struct Cpu {
    /// The instruction set.
    pub level: InstructionSet,
}

impl Cpu {
    /// Returns the backend on the fastest instruction set of this machine.
    pub fn best() -> Self {
        Self {
            level: InstructionSet::best(),
        }
    }
}

impl Backend for Cpu {
    fn id(&self) -> Option<&str> {
        None
    }

    fn begin(self: Arc<Self>, training: &mut Training) -> Result<Box<dyn Session>, FieldError> {
        Ok(Box::new(CpuSession::new(self.level, training)))
    }

    fn renderer(self: Arc<Self>, _: &Model) -> Result<Arc<dyn Renderer>, FieldError> {
        Ok(self)
    }
}

impl Renderer for Cpu {
    fn rows(
        &self,
        model: &Model,
        camera: &Camera,
        cam_from_world: &Pose,
        rows: Range<u32>,
    ) -> Result<Render, FieldError> {
        Ok(render_rows(self.level, model, camera, cam_from_world, rows))
    }
}

/// A training on the CPU; its state is always that of the training.
struct CpuSession {
    level: InstructionSet,
    /// Gradients of the tables, all zero between steps.
    gradients: Vec<Vec<f32>>,
    /// Memory of the last batch.
    chunks: Vec<Chunk>,
    spares: Spares,
}

impl Session for CpuSession {
    /// Takes one step.
    fn advance(&mut self, training: &mut Training, _: u64) -> Result<Step, FieldError> {
        self.step(training)
    }

    fn upload(&mut self, _: &Training) -> Result<(), FieldError> {
        Ok(())
    }

    fn download(&self, _: &mut State) -> Result<(), FieldError> {
        Ok(())
    }
}

impl CpuSession {
    fn new(level: InstructionSet, training: &mut Training) -> Self {
        // Integer gradients, and so their scales, are a GPU's alone.
        training.state.scales.clear();
        let tables = &training.state.weights.tables;
        Self {
            level,
            gradients: tables.iter().map(|table| vec![0.0; table.len()]).collect(),
            chunks: Vec::new(),
            spares: Spares::default(),
        }
    }

    /// Takes one optimiser step.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`]; the training then still holds the state before the step.
    fn step(&mut self, training: &mut Training) -> Result<Step, FieldError> {
        let targets = training.targets();
        let shared = Shared {
            level: self.level,
            config: &training.config,
            weights: &training.state.weights,
            steps: &training.march,
            bits: &training.state.occupancy.bits,
            rays: targets.len(),
        };
        let rays = training.chunk_rays();
        batch::train(&shared, &targets, rays, &mut self.chunks, &self.spares);
        check(training, &self.chunks)?;
        learn(self.level, training, &mut self.gradients, &self.chunks);
        let rays = targets.len() as u64;
        let found = || self.chunks.iter().map(|chunk| &chunk.found);
        let loss: f64 = found().map(|found| found.loss).sum();
        let visited: u64 = found().map(|found| found.visited).sum();
        let samples: u64 = found().map(|found| found.samples).sum();
        training.state.steps += 1;
        training.state.learn_cost(rays, visited, samples);
        if training.state.steps.is_multiple_of(UPDATE_EVERY) {
            update_occupancy(self.level, training);
            training.halve_steps();
        }
        Ok(Step {
            steps: 1,
            loss: loss / (3 * rays) as f64,
            rays,
            samples,
        })
    }
}

/// Refuses a batch with a number that runs away, before any weight has changed.
fn check(training: &Training, chunks: &[Chunk]) -> Result<(), FieldError> {
    let bad = |tensor, place: String| FieldError::NotFinite {
        step: training.state.steps,
        tensor,
        place,
        learning_rate: training.config.learning_rate,
    };
    // A background's colour and a gain are finite whatever these are.
    for (tensor, values) in [
        ("background", &training.state.weights.background),
        ("gains", &training.state.gains),
    ] {
        if let Some(place) = values.iter().position(|value| runs_away(*value)) {
            return Err(bad(tensor, place.to_string()));
        }
    }
    for (chunk, found) in chunks.iter().map(|chunk| &chunk.found).enumerate() {
        let tensor = found.bad.or_else(|| found.runaway_gradient());
        if let Some(tensor) = tensor {
            return Err(bad(tensor, format!("chunk {chunk}")));
        }
    }
    Ok(())
}

/// Computes the density of some cells anew and decides which are occupied.
fn update_occupancy(level: InstructionSet, training: &mut Training) {
    let round = training.state.steps / UPDATE_EVERY;
    let (occupied, empty) = if round <= 16 { (4, 4) } else { (4, 16) };
    let probes = training
        .state
        .occupancy
        .probes(training.seed, round, occupied, empty);
    let weights = &training.state.weights;
    let chunks = probes.par_chunks(2048).map_init(Shade::default, |shade, probes| {
        shade.samples.resize(0);
        shade.samples.x.extend(probes.iter().map(|probe| probe.at[0]));
        shade.samples.y.extend(probes.iter().map(|probe| probe.at[1]));
        shade.samples.z.extend(probes.iter().map(|probe| probe.at[2]));
        shade.densities(level, weights);
        let density = |raw: &f32| {
            if raw.is_finite() {
                exp(raw + RAW_SHIFT)
            } else {
                f32::NAN
            }
        };
        shade.raw[..probes.len()]
            .iter()
            .map(density)
            .collect::<Vec<f32>>()
    });
    let found = chunks.collect::<Vec<_>>().concat();
    training
        .state
        .occupancy
        .update(&probes, &found, training.config.min_step as f32);
}

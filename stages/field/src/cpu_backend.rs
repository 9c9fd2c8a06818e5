//! The CPU as a backend: the same bytes for any number of threads and on every instruction set.

use std::ops::Range;
use std::sync::Arc;

use marf_scene::{Camera, Pose};

use crate::FieldError;
use crate::backend::{Backend, Renderer, Session, Step};
use crate::batch::{self, Chunk, Spares, StepContext};
use crate::cpu::clearance::Clearance;
use crate::cpu::composite::runs_away;
use crate::cpu::simd::InstructionSet;
use crate::learn::learn;
use crate::model::Model;
use crate::occupancy::due_every;
use crate::picture::Render;
use crate::render::{Accuracy, Viewpoint};
use crate::schedule::UPDATE_EVERY;
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

    fn renderer(self: Arc<Self>, model: &Model) -> Result<Arc<dyn Renderer>, FieldError> {
        Ok(Arc::new(CpuRenderer {
            level: self.level,
            clearance: Clearance::new(&model.bits),
        }))
    }
}

/// What the CPU renders a model with.
#[derive(Debug)]
struct CpuRenderer {
    level: InstructionSet,
    clearance: Clearance,
}

impl Renderer for CpuRenderer {
    fn rows(
        &self,
        model: &Model,
        camera: &Camera,
        cam_from_world: &Pose,
        rows: Range<u32>,
    ) -> Result<Render, FieldError> {
        let view = Viewpoint {
            level: self.level,
            model,
            clearance: &self.clearance,
            camera,
            world_from_cam: cam_from_world.inverse(),
            accuracy: Accuracy::PICTURE,
        };
        Ok(view.rows(rows))
    }
}

/// A training on the CPU. Its state is always that of the training.
struct CpuSession {
    level: InstructionSet,
    /// Empty space between the occupied cells. It is updated with them.
    clearance: Clearance,
    /// Gradients of the tables, all zero between steps.
    gradients: Vec<Vec<f32>>,
    /// Memory of the last batch.
    chunks: Vec<Chunk>,
    /// Memory of the last cells that were looked at.
    probed: Vec<Chunk>,
    spares: Spares,
}

impl Session for CpuSession {
    /// Takes one step.
    fn advance(&mut self, training: &mut Training, _: u64) -> Result<Step, FieldError> {
        self.step(training)
    }

    fn settle(&mut self, _: &mut Training) -> Result<Step, FieldError> {
        Ok(Step::default())
    }

    fn upload(&mut self, training: &Training) -> Result<(), FieldError> {
        self.clearance = Clearance::new(&training.state.occupancy.bits);
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
            clearance: Clearance::new(&training.state.occupancy.bits),
            gradients: tables.iter().map(|table| vec![0.0; table.len()]).collect(),
            chunks: Vec::new(),
            probed: Vec::new(),
            spares: Spares::default(),
        }
    }

    /// Takes one optimiser step.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`]. The training then still holds the state before the step.
    fn step(&mut self, training: &mut Training) -> Result<Step, FieldError> {
        let targets = training.targets();
        let shared = StepContext {
            level: self.level,
            config: &training.config,
            weights: &training.state.weights,
            steps: &training.march,
            bits: &training.state.occupancy.bits,
            clearance: &self.clearance,
            rays: targets.len(),
            ray_samples: training.ray_samples(),
            distortion: training.distortion_at(training.state.steps),
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
            update_occupancy(self, training);
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
        if let Some(tensor) = found.bad {
            return Err(bad(tensor, format!("chunk {chunk}")));
        }
    }
    Ok(())
}

/// Recomputes the density of some cells and decides which are occupied.
fn update_occupancy(session: &mut CpuSession, training: &mut Training) {
    let round = training.state.steps / UPDATE_EVERY;
    let [occupied, empty] = due_every(round);
    let occupancy = &training.state.occupancy;
    let probes = occupancy.probes(training.seed, round, occupied, empty);
    let (weights, spares) = (&training.state.weights, &session.spares);
    let found = batch::densities(session.level, weights, &probes, &mut session.probed, spares);
    let step = training.config.min_step as f32;
    training.state.occupancy.update(&probes, &found, step);
    session.clearance = Clearance::new(&training.state.occupancy.bits);
}

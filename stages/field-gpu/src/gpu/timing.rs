//! What every kernel of a training step takes: for `cargo bench` alone.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::Gpu;
use super::cost::{BatchFill, Cost, Slots, apart, costs};
use super::record::{Watch, Work};
use super::session::GpuSession;
use super::tables::Averages;
use marf_field::backend::{Session, Step};
#[cfg(test)]
use marf_field::state::State;
use marf_field::training::Training;
use marf_field::{Config, FieldError, View};

/// Steps that were timed.
#[derive(Clone, Debug, PartialEq)]
pub struct StepTimes {
    /// Steps.
    pub steps: u64,
    /// Rays of their batches.
    pub rays: u64,
    /// Samples that rays visited.
    pub visited: u64,
    /// Samples that were trained.
    pub samples: u64,
    /// The kernels, the one that took longest first.
    pub kernels: Vec<KernelTime>,
    /// Seconds that updates of the occupancy took a step, one in 16.
    pub update_s: f64,
    /// Rows of the tables that Adam moved.
    rows: u64,
}

/// What the kernels of a step work on, in the mean over steps: what a model of their times is made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shape {
    /// Rays.
    pub rays: f64,
    /// Samples that rays visited.
    pub visited: f64,
    /// Samples that were trained.
    pub kept: f64,
    /// Steps along a ray, occupied or not.
    pub steps_a_ray: f64,
    /// Photos.
    pub photos: usize,
    /// Levels of the grid.
    pub levels: usize,
    /// Features an entry.
    pub features: usize,
    /// Numbers of all tables.
    pub table_numbers: usize,
    /// Rows of the tables that Adam moved.
    pub rows_moved: f64,
    /// Inputs and outputs of the layers of the density network.
    pub density: Vec<[usize; 2]>,
    /// Inputs and outputs of the layers of the colour network.
    pub color: Vec<[usize; 2]>,
}

/// What a kernel took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KernelTime {
    /// Its name.
    pub name: &'static str,
    /// Dispatches a step.
    pub calls: f64,
    /// Seconds a step.
    pub seconds: f64,
    /// What it had to do in a step, where that can be counted.
    pub load: Option<Load>,
}

/// What binds a kernel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Load {
    /// Bytes that it cannot do without, read and written.
    Bytes(f64),
    /// Operations, two a multiply-add.
    Operations(f64),
}

/// A training on a GPU whose kernels are timed.
pub struct TimedTraining {
    training: Training,
    session: GpuSession,
}

impl TimedTraining {
    /// Returns a training at step 0 on a GPU.
    ///
    /// # Errors
    /// As [`marf_field::Trainer::from_training`].
    pub fn new(gpu: &Arc<Gpu>, views: Vec<View>, config: &Config, seed: u64) -> Result<Self, FieldError> {
        let mut training = Training::new(views, &[], config, seed)?;
        let session = GpuSession::new(gpu, &mut training)?;
        Ok(Self { training, session })
    }

    /// Returns the shape of the timed steps.
    pub fn shape(&self, timed: &StepTimes) -> Shape {
        let (training, session) = (&self.training, &self.session);
        let each = |count: u64| count as f64 / timed.steps as f64;
        let layers = &session.held.weights.layers;
        let (density, color) = layers.shapes.split_at(layers.density);
        Shape {
            rays: each(timed.rays),
            visited: each(timed.visited),
            kept: each(timed.samples),
            steps_a_ray: training.march.count as f64,
            photos: training.views.len(),
            levels: training.state.weights.shapes.len(),
            features: session.held.grid.features(),
            table_numbers: session.held.grid.numbers(),
            rows_moved: each(timed.rows),
            density: density.to_vec(),
            color: color.to_vec(),
        }
    }

    /// Returns the state that was last brought back.
    #[cfg(test)]
    pub(crate) fn state(&self) -> &State {
        &self.training.state
    }

    /// Takes `steps` steps and returns the samples that were trained.
    ///
    /// # Errors
    /// As [`marf_field::Trainer::advance`].
    pub fn advance(&mut self, steps: u64) -> Result<u64, FieldError> {
        Ok(self.session.watch_steps(&mut self.training, steps, None)?.samples)
    }

    /// Halves the steps along rays so often, whatever is due, at most as often as the training ever does.
    ///
    /// # Errors
    /// A lost device.
    pub fn halve(&mut self, halvings: u32) -> Result<(), FieldError> {
        let (training, session) = (&mut self.training, &mut self.session);
        session.download(&mut training.state)?;
        training.state.catch_up();
        let halvings = halvings.min(training.sizes.halvings.value);
        let more = halvings as i32 - training.state.halvings as i32;
        training.state.samples_per_ray *= 2.0_f64.powi(more);
        training.state.halvings = halvings;
        training.march = training.sizes.steps(&training.config, halvings);
        session.upload(training)
    }

    /// Returns the costs of the kernels of a step with these samples that also moves the averages, in their
    /// order.
    ///
    /// Columns grow with their samples: a small batch predicts a large one. `None` where a kernel has no
    /// cost.
    pub fn costs(&self, filled: &BatchFill) -> Option<Vec<Cost>> {
        let session = &self.session;
        let slots = Slots {
            capacity: session.held.lanes.capacity,
            rays: session.held.lanes.rays.slots,
        };
        costs(
            &Work::recorded(|recorder| session.record(recorder, 1, Averages::Follow)),
            slots,
            filled,
        )
    }

    /// Returns the share of corners of the last step's samples that are added to the tables: see [`BatchFill::apart`].
    ///
    /// # Errors
    /// A lost device.
    pub fn apart(&self) -> Result<f64, FieldError> {
        let (gpu, lanes) = (&self.session.gpu, &self.session.held.lanes);
        let kept = gpu.read(&lanes.counts)?[marf_shaders::counts::KEPT as usize] as usize;
        let (xyz, origin) = (gpu.read(&lanes.visited.xyz)?, gpu.read(&lanes.origin)?);
        let places = origin[..kept].iter().map(|visited| *visited as usize);
        let samples: Vec<[f32; 3]> = places
            .map(|at| [0, 1, 2].map(|axis| xyz[axis * lanes.capacity + at]))
            .collect();
        let levels = self.training.state.weights.shapes.iter();
        let resolutions: Vec<u32> = levels.map(|shape| shape.resolution).collect();
        Ok(apart(&samples, &resolutions))
    }

    /// Takes `steps` steps, every dispatch between two timestamps.
    ///
    /// # Errors
    /// As [`marf_field::Trainer::advance`]. A device without timestamps.
    pub fn time(&mut self, steps: u64) -> Result<StepTimes, FieldError> {
        let (training, session) = (&mut self.training, &mut self.session);
        session.download(&mut training.state)?;
        let before = rows_moved(training);
        let mut watch = Watch::default();
        let sum = session.watch_steps(training, steps, Some(&mut watch))?;
        session.download(&mut training.state)?;
        let rows = rows_moved(training) - before;
        Ok(session.timed(training, &watch, sum, rows))
    }
}

/// Returns the rows of the tables that Adam has moved, in all steps so far.
fn rows_moved(training: &Training) -> u64 {
    let levels = training.state.weights.tables.len();
    let counts = training.state.moments[..levels]
        .iter()
        .flat_map(|level| &level.count);
    counts.map(|count| u64::from(*count)).sum()
}

impl GpuSession {
    /// Takes `steps` steps and waits for them.
    fn watch_steps(
        &mut self,
        training: &mut Training,
        steps: u64,
        mut watch: Option<&mut Watch>,
    ) -> Result<Step, FieldError> {
        let end = training.state.steps + steps;
        let mut sum = Step::default();
        while training.state.steps < end {
            let most = end - training.state.steps;
            sum = sum.and(self.watched(training, most, watch.as_deref_mut())?);
        }
        Ok(sum.and(self.settled(training, watch)?))
    }

    fn timed(&self, training: &Training, watch: &Watch, sum: Step, rows: u64) -> StepTimes {
        let steps = sum.steps as f64;
        let mut kernels: Vec<KernelTime> = Vec::new();
        for (name, seconds) in &watch.steps {
            let known = kernels.iter().position(|kernel| kernel.name == *name);
            let index = known.unwrap_or(kernels.len());
            if known.is_none() {
                kernels.push(KernelTime {
                    name,
                    calls: 0.0,
                    seconds: 0.0,
                    load: self.load(name, training, watch, sum, rows),
                });
            }
            kernels[index].calls += 1.0 / steps;
            kernels[index].seconds += seconds / steps;
        }
        kernels.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        StepTimes {
            steps: sum.steps,
            rays: sum.rays,
            visited: watch.visited,
            samples: sum.samples,
            kernels,
            update_s: watch.updates.iter().map(|(_, seconds)| seconds).sum::<f64>() / steps,
            rows,
        }
    }

    /// Returns the load of a kernel in a step, counted from its reads, writes and operations.
    fn load(&self, name: &str, training: &Training, watch: &Watch, sum: Step, rows: u64) -> Option<Load> {
        let [visited, kept, rows] =
            [watch.visited, sum.samples, rows].map(|count| count as f64 / sum.steps as f64);
        let layers = &self.held.weights.layers;
        let sizes = layers
            .shapes
            .iter()
            .map(|[inputs, outputs]| (inputs * outputs) as f64);
        let sizes: Vec<f64> = sizes.collect();
        let (density, color) = sizes.split_at(layers.density);
        let (density, color): (f64, f64) = (density.iter().sum(), color.iter().sum());
        let entries = 4.0 * self.held.grid.numbers() as f64;
        let row = 4.0 * self.held.grid.features() as f64;
        Some(match name {
            // Weight and both moments read and written, the count too. The gradient's zeros written. Where
            // averages are due, these are read and written, too, and all weights read.
            "adam_table" => {
                let steps = training.state.steps - sum.steps..training.state.steps;
                let due = steps.filter(|step| training.kept_at(*step).is_some()).count();
                let share = due as f64 / sum.steps as f64;
                Load::Bytes(entries * (1.0 + 3.0 * share) + rows * (7.0 * row + 8.0))
            }
            "peak" => Load::Bytes(entries),
            "density" => Load::Operations(2.0 * visited * density),
            "shade" => Load::Operations(2.0 * kept * color),
            // Forward again, and two products a weight on the way back.
            "back" => Load::Operations(6.0 * kept * (density + color)),
            _ => return None,
        })
    }
}

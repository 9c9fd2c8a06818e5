//! A training on a device: what stays there between steps, and the steps.

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use marf_shaders::{Pace, Step as StepUniform, Total, faults};

use super::Gpu;
use super::array::Reading;
use super::forward::{Forward, Kernels as Shared, write_chosen, write_walks};
use super::kernel::Bound;
use super::learning::{Bindings, Kernels, Learning};
use super::light::RING;
use super::march::{March, MarchPasses, step_table, whole_walk};
use super::memory::DeviceState;
use super::nets::Rows;
use super::occupancy::{self, ProbeArrays, ProbeSchedule, Update};
use super::rays::{DrawRays, observed};
use super::record::{Recorder, Work};
use super::submits::Submits;
use super::tables::{Rise, rates};
use super::totals::{LATE_FROM, add, fault, note_costs};
use marf_field::FieldError;
use marf_field::GpuError;
use marf_field::backend::{Session, Step};
use marf_field::occupancy::due_every;
use marf_field::schedule::{EPSILON, UPDATE_EVERY};
use marf_field::state::State;
use marf_field::training::Training;

/// Passes over the gradients of the first step: the first scale is a guess, the second close, the third good.
const CALIBRATIONS: usize = 2;

/// A training on a device.
pub struct GpuSession {
    pub(super) gpu: Arc<Gpu>,
    pub(super) held: DeviceState,
    draw: Bound,
    marching: MarchPasses,
    forward: Forward,
    learning: Learning,
    /// From places in cells to their raw densities.
    probed: Work,
    update: Update,
    pub(super) submits: Submits,
    /// The steps of the last call, whose outcome the host has not read.
    pending: Option<SubmittedSteps>,
}

/// Steps that were submitted.
struct SubmittedSteps {
    steps: Range<u64>,
    submitted: Instant,
    totals: Reading<Total>,
    before: RayCost,
}

/// What decided the rays of some steps.
#[derive(Clone, Copy)]
struct RayCost {
    halvings: u32,
    samples_per_ray: f64,
    late_samples_per_ray: Option<f64>,
}

impl GpuSession {
    /// Copies a training to a device, compiles the kernels and finds the scales of the first step.
    ///
    /// # Errors
    /// A device that lacks something or has too little memory.
    pub fn new(gpu: &Arc<Gpu>, training: &mut Training) -> Result<Self, FieldError> {
        let device = gpu.as_ref();
        let (config, state) = (&training.config, &training.state);
        let held = DeviceState::new(device, training)?;
        let DeviceState {
            grid,
            weights,
            average,
            lanes,
            arrays,
            photos,
            observations,
            step,
            occupancy,
        } = &held;
        let features = state.weights.features;
        let (shared, kernels) = (
            Shared::new(device, features, &weights.layers)?,
            Kernels::new(device, features)?,
        );
        let draw = DrawRays::new(device)?.bind(device, step, photos, observations, &lanes.rays);
        let marching = March::new(device)?.bind(device, lanes.marched(&occupancy.bits));
        let forward = Forward::new(device, &shared, grid, weights, lanes)?;
        let learning = Learning::new(Bindings {
            gpu: device,
            shared: &shared,
            kernels: &kernels,
            grid,
            weights,
            average,
            lanes,
            arrays,
            config,
            step,
        })?;
        let raw = lanes.densities(device, &shared, grid, weights, Rows::Density)?;
        let probed = ProbeArrays {
            xyz: &lanes.visited.xyz,
            raw: &lanes.latent,
            faults: &lanes.faults,
            cells: &lanes.origin,
            counts: &lanes.counts,
        };
        let min_step = config.min_step as f32;
        let cells = occupancy::Kernels::new(device)?;
        let update = Update::new(device, &cells, occupancy, probed, min_step)?;
        let mut session = Self {
            gpu: gpu.clone(),
            held,
            draw,
            marching,
            forward,
            learning,
            probed: raw,
            update,
            submits: Submits::default(),
            pending: None,
        };
        session.write_march(training);
        session.calibrate(training);
        session.probe(training, 0);
        training.state.scales = session.scales()?;
        session.upload(training)?;
        Ok(session)
    }

    /// Finds the scales of the first step by its own gradients, which are then thrown away. Also compiles all
    /// kernels of drivers that compile at the first use.
    fn calibrate(&self, training: &Training) {
        let rays = training.ray_count().min(self.held.lanes.rays.slots);
        self.begin(training, rays);
        self.held
            .arrays
            .write_rise(&self.gpu, &self.held.grid, Rise::Free);
        for _ in 0..CALIBRATIONS {
            self.write_step(training, training.state.steps, rays);
            self.submits.submit(&self.gpu, |recorder| {
                self.forward(recorder, rays);
                self.learning.back.record_for(recorder, rays);
                self.learning.scale.record(recorder);
            });
            self.held.arrays.clear_gradient(&self.gpu);
        }
        self.held
            .arrays
            .write_rise(&self.gpu, &self.held.grid, Rise::Slow);
        // Everything else that is written here is uploaded again.
        self.write_step(training, training.state.steps, 0);
        self.begin(training, 0);
        self.submits
            .submit(&self.gpu, |recorder| self.record(recorder, 0));
    }

    /// Takes steps up to the next update of the occupancy, and reports those of the call before. Their costs
    /// decide the rays of the next call: the device works on meanwhile. The first steps are waited for.
    fn take_steps(&mut self, training: &mut Training, most: u64) -> Result<Step, FieldError> {
        self.gpu.poll(wgpu::PollType::Poll)?;
        let first = training.state.steps;
        let update = (first / UPDATE_EVERY + 1) * UPDATE_EVERY;
        let end = first.saturating_add(most.max(1)).min(update);
        let rays = training.ray_count().min(self.held.lanes.rays.slots);
        self.begin(training, rays);
        let submitted = Instant::now();
        for number in first..end {
            self.write_step(training, number, rays);
            self.submits
                .submit(&self.gpu, |recorder| self.record(recorder, rays));
        }
        let totals = self.gpu.copy_back(&self.held.arrays.ring);
        let (halvings, samples_per_ray) = (training.state.halvings, training.state.samples_per_ray);
        training.state.steps = end;
        if end == update {
            self.probe(training, update / UPDATE_EVERY);
        }
        let earlier = self.pending.take();
        let mut told = self.told(training, earlier)?;
        self.pending = Some(SubmittedSteps {
            steps: first..end,
            submitted,
            totals,
            before: RayCost {
                halvings,
                samples_per_ray,
                late_samples_per_ray: training.state.late_samples_per_ray,
            },
        });
        training.state.catch_up();
        if end <= LATE_FROM {
            told = told.and(self.settled(training)?);
        }
        if end == update {
            training.halve_steps();
            if training.state.halvings != halvings {
                self.write_march(training);
            }
        }
        Ok(told)
    }

    /// Waits for the steps of the last call and reports them.
    fn settled(&mut self, training: &mut Training) -> Result<Step, FieldError> {
        let last = self.pending.take();
        self.told(training, last)
    }

    /// Waits for some steps, reports them, and notes what their rays cost.
    fn told(&mut self, training: &mut Training, pending: Option<SubmittedSteps>) -> Result<Step, FieldError> {
        let mut sum = Step::default();
        let Some(pending) = pending else {
            return Ok(sum);
        };
        let totals = self.gpu.received(pending.totals)?;
        let SubmittedSteps { steps, before, .. } = pending;
        self.submits.took(steps.end - steps.start, pending.submitted);
        let totals: Vec<Total> = steps.clone().map(|step| totals[step as usize % RING]).collect();
        let sound = totals.iter().take_while(|total| total.faults == 0).count();
        if let Some(bad) = totals.get(sound) {
            self.stop(training, steps.start, before, &totals[..sound]);
            return Err(fault(training, bad));
        }
        // Steps along rays that were halved since visit as many more samples.
        let longer = f64::from(1_u32 << (training.state.halvings - before.halvings));
        note_costs(&mut training.state, &totals, longer);
        totals.iter().for_each(|total| add(&mut sum, total));
        Ok(sum)
    }

    /// Puts the training where it was before some steps, and behind those of them whose numbers were finite.
    /// The device has taken none since.
    fn stop(&self, training: &mut Training, first: u64, before: RayCost, sound: &[Total]) {
        let state = &mut training.state;
        state.steps = first + sound.len() as u64;
        state.samples_per_ray = before.samples_per_ray;
        state.late_samples_per_ray = before.late_samples_per_ray;
        if !sound.is_empty() {
            state.catch_up();
            note_costs(state, sound, 1.0);
        }
        if state.halvings != before.halvings {
            state.halvings = before.halvings;
            training.march = training.sizes.steps(&training.config, before.halvings);
            self.write_march(training);
        }
    }

    /// Writes the number of rays to the uniforms of the walks.
    fn begin(&self, training: &Training, rays: usize) {
        let side = training.config.occupancy_resolution;
        let (slots, capacity) = (self.held.lanes.rays.slots, self.held.lanes.capacity);
        let whole = whole_walk(rays, slots, capacity, &training.march, side);
        write_walks(&self.gpu, &self.held.lanes, whole);
    }

    /// Writes the uniforms of a step.
    fn write_step(&self, training: &Training, number: u64, rays: usize) {
        let rate = training.rate_at(number);
        let pull = training.pull_at(number, rays);
        let step = StepUniform {
            rays: rays as u32,
            rate,
            pull: pull.unwrap_or(0.0),
            observations: pull.map_or(0, |_| self.held.observations.len() as u32),
            ..self.held.photos.step(training.seed, number)
        };
        // Where averages are not due, they keep all.
        let keep = training.kept_at(number).unwrap_or(1.0);
        let pace = Pace {
            rate,
            total: number as u32 % RING as u32,
            keep,
            pad: 0,
        };
        let gpu = &self.gpu;
        gpu.write(&self.held.step, 0, &[step]);
        gpu.write(&self.held.arrays.pace, 0, &[pace]);
        self.held
            .arrays
            .write_losses(gpu, &self.held.lanes, training, number);
        let rates = rates(rate, EPSILON, training.table_decay_at(number), keep);
        gpu.write(&self.held.arrays.rates, 0, &[rates]);
    }

    /// Records a step.
    pub(super) fn record(&self, recorder: &mut Recorder<'_>, rays: usize) {
        self.forward(recorder, rays);
        self.learning.record(recorder, rays);
    }

    fn forward(&self, recorder: &mut Recorder<'_>, rays: usize) {
        recorder.threads(&self.draw, rays);
        self.marching.record(recorder, rays);
        self.forward.densities.record(recorder);
        self.forward.colours.record_for(recorder, rays);
    }

    /// Recomputes the density of some cells and decides which are occupied.
    fn probe(&self, training: &Training, round: u64) {
        let [occupied, empty] = due_every(round).map(|every| every as u32);
        let due = ProbeSchedule {
            round,
            occupied,
            empty,
        };
        self.update.begin(&self.gpu, training.seed, due);
        for pass in 0..self.update.passes() {
            let none = [0];
            self.gpu.write(
                &self.held.lanes.counts,
                marf_shaders::counts::VISITED as usize,
                &none,
            );
            self.submits.submit(&self.gpu, |recorder| {
                self.update.probe(recorder, pass);
                self.probed.record(recorder);
                self.update.found(recorder);
            });
        }
        self.submits
            .submit(&self.gpu, |recorder| self.update.finish(recorder));
    }

    /// Copies what depends on the length of the steps along rays.
    fn write_march(&self, training: &Training) {
        let gpu = &self.gpu;
        write_chosen(gpu, &self.held.lanes, training.ray_samples());
        gpu.write(&self.held.lanes.steps, 0, &step_table(&training.march));
        gpu.write(
            &self.held.observations,
            0,
            &observed(&training.observations, &training.march),
        );
    }

    fn scales(&self) -> Result<Vec<f32>, GpuError> {
        let scales = self.gpu.read(&self.held.arrays.scales)?;
        Ok(scales.iter().map(|level| level.scale).collect())
    }
}

impl Session for GpuSession {
    /// Takes steps up to the next update of the occupancy.
    fn advance(&mut self, training: &mut Training, most: u64) -> Result<Step, FieldError> {
        self.take_steps(training, most)
    }

    fn settle(&mut self, training: &mut Training) -> Result<Step, FieldError> {
        self.settled(training)
    }

    fn upload(&mut self, training: &Training) -> Result<(), FieldError> {
        self.pending = None;
        let (gpu, state) = (self.gpu.as_ref(), &training.state);
        self.held.weights.write(gpu, &self.held.grid, &state.weights);
        self.held.average.write(gpu, &self.held.grid, &state.average);
        let (tables, nets) = state.moments.split_at(state.weights.tables.len());
        self.held.arrays.write_table_moments(gpu, &self.held.grid, tables);
        self.held.arrays.write_net_moments(gpu, nets);
        self.held
            .arrays
            .exposures
            .write(gpu, &state.gains, &state.gain_moments);
        self.held.occupancy.write(gpu, &state.occupancy);
        if !state.scales.is_empty() {
            let mut scales = gpu.read(&self.held.arrays.scales)?;
            for (level, scale) in scales.iter_mut().zip(&state.scales) {
                level.scale = *scale;
            }
            gpu.write(&self.held.arrays.scales, 0, &scales);
        }
        gpu.write(&self.held.lanes.faults, 0, &[0; faults::LEN]);
        self.write_march(training);
        Ok(gpu.wait()?)
    }

    fn download(&self, state: &mut State) -> Result<(), FieldError> {
        debug_assert!(self.pending.is_none(), "steps are settled first");
        let gpu = self.gpu.as_ref();
        self.held.weights.read(gpu, &self.held.grid, &mut state.weights)?;
        self.held.average.read(gpu, &self.held.grid, &mut state.average)?;
        let (tables, nets) = state.moments.split_at_mut(state.weights.tables.len());
        self.held
            .arrays
            .read_table_moments(gpu, &self.held.grid, tables)?;
        self.held.arrays.read_net_moments(gpu, nets)?;
        let (gains, moments) = (&mut state.gains, &mut state.gain_moments);
        self.held.arrays.exposures.read(gpu, gains, moments)?;
        state.occupancy = self.held.occupancy.read(gpu)?;
        state.scales = self.scales()?;
        Ok(())
    }
}

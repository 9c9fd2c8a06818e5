use marf_scene::Pose;
use rayon::prelude::*;

use crate::batch::{self, Chunk, Shared, Spares, Target};
use crate::cpu::adam::{Bias, Moments};
use crate::cpu::composite::{RAW_SHIFT, runs_away};
use crate::cpu::march::Steps;
use crate::cpu::math::exp;
use crate::cpu::simd::Level;
use crate::depth::{Pull, SHARE, Sighting, place, sightings};
use crate::exposure::Exposure;
use crate::frame::Frame;
use crate::gpu::Session;
use crate::occupancy::Occupancy;
use crate::rng::{Fingerprint, Purpose, Rng};
use crate::shade::Shade;
use crate::views::{View, check_points, check_views, pixel_offsets};
use crate::weights::{NET_ROW, Weights};
use crate::{
    Background, Config, Device, Facts, Field, FieldError, LevelFacts, Occupied, Sizes, background, size,
};

/// What one optimiser step did, or some on a GPU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Optimiser steps.
    pub steps: u64,
    /// Mean squared error over rays and channels of the batches, sRGB in [0, 1].
    pub loss: f64,
    /// Rays of the batches.
    pub rays: u64,
    /// Samples that were trained.
    pub samples: u64,
}

/// Optimiser steps after which the steps along rays are halved: long ones find a surface sooner, short ones place it
/// better. Multiples of [`UPDATE_EVERY`].
const HALVED_AT: [u64; 3] = [640, 8_192, 65_536];
/// Rays with fewer samples than this bear halved steps at once; looked at every [`FEW_AT`] steps.
const FEW_SAMPLES: f64 = 8.0;
const FEW_AT: u64 = 128;
/// Steps between two updates of the occupancy.
pub(crate) const UPDATE_EVERY: u64 = 16;
/// Samples a chunk of rays aims at: its rows then stay in the second cache.
const CHUNK_SAMPLES: f64 = 768.0;

/// Trains a field on a set of views.
pub struct Trainer {
    pub(crate) level: Level,
    pub(crate) config: Config,
    pub(crate) seed: u64,
    pub(crate) views: Vec<View>,
    pub(crate) world_from_cams: Vec<Pose>,
    /// Number of the first kept pixel of every view, and of all at the end.
    pub(crate) pixels: Vec<u64>,
    pub(crate) frame: Frame,
    pub(crate) sizes: Sizes,
    pub(crate) march: Steps,
    /// What the views see of the sparse points; empty where they do not pull.
    pub(crate) sightings: Vec<Sighting>,
    pub(crate) bias: Bias,
    pub(crate) gradients: Vec<Vec<f32>>,
    /// Memory of the last batch.
    chunks: Vec<Chunk>,
    spares: Spares,
    pub(crate) state: State,
    /// Where the training runs, if not here.
    pub(crate) session: Option<Session>,
}

/// All that changes in training, and nothing else.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct State {
    pub steps: u64,
    /// Times that the steps along rays have been halved.
    pub halvings: u32,
    pub samples_per_ray: f64,
    pub weights: Weights,
    pub average: Weights,
    /// In the order of `Weights::tensors`.
    pub moments: Vec<Moments>,
    /// `[views, 4]` log gains; the fourth number is unused. Then as many offsets, if photos have them.
    pub gains: Vec<f32>,
    pub gain_moments: Moments,
    pub occupancy: Occupancy,
    /// Scales of the tables' integer gradients, level by level; empty on the CPU.
    pub scales: Vec<f32>,
}

impl State {
    /// Takes down what the rays of a batch cost; a sample that is trained counts four times one that is visited.
    pub(crate) fn learn_cost(&mut self, rays: u64, visited: u64, trained: u64) {
        let cost = (visited + 3 * trained) as f64 / (4 * rays) as f64;
        self.samples_per_ray = self.samples_per_ray * 0.8 + cost.max(1.0) * 0.2;
    }
}

impl Trainer {
    /// Makes a trainer at step 0.
    ///
    /// `points` are sparse surface points in the world; they may be empty.
    ///
    /// # Errors
    /// See [`FieldError`]: no views, sizes that differ, cameras that are not finite, a key out of range.
    pub fn new(
        views: Vec<View>,
        points: &[[f64; 3]],
        config: &Config,
        seed: u64,
    ) -> Result<Self, FieldError> {
        config.check()?;
        check_views(&views)?;
        check_points(points)?;
        let frame = Frame::derive(&views, points);
        frame.check(&views)?;
        let sizes = size::derive(&views, points, config, &frame);
        let mut weights = Weights::zeros(config, &sizes);
        weights.randomise(seed);
        if config.background == Background::Direction {
            weights.background = background::fit(&views);
        }
        let tensors = weights.tensors();
        let rows = |name: &str| {
            if name.starts_with("table") {
                weights.features
            } else {
                NET_ROW
            }
        };
        let moments = tensors
            .iter()
            .map(|(name, values)| Moments::new(values.len(), rows(name)));
        let march = sizes.steps(config, 0);
        let side = config.occupancy_resolution;
        let occupancy = match config.occupied {
            Occupied::Seen => Occupancy::full(side, &frame, &views),
            Occupied::NearPoints => Occupancy::near(side, &frame, &views, points),
        };
        let state = State {
            steps: 0,
            halvings: 0,
            samples_per_ray: march.count as f64,
            average: weights.clone(),
            moments: moments.collect(),
            gains: vec![0.0; config.gain.numbers(views.len())],
            gain_moments: Moments::new(config.gain.numbers(views.len()), 4),
            occupancy,
            scales: Vec::new(),
            weights,
        };
        let pixels = pixel_offsets(&views);
        let sightings = if config.depth_weight > 0.0 {
            sightings(&views, &pixels, points, &frame, &march)
        } else {
            Vec::new()
        };
        Ok(Self {
            level: Level::best(),
            config: config.clone(),
            seed,
            world_from_cams: views.iter().map(|view| view.cam_from_world.inverse()).collect(),
            pixels,
            views,
            frame,
            sizes,
            march,
            sightings,
            bias: Bias::default(),
            gradients: state
                .weights
                .tables
                .iter()
                .map(|table| vec![0.0; table.len()])
                .collect(),
            chunks: Vec::new(),
            spares: Spares::default(),
            state,
            session: None,
        })
    }

    /// Moves the training to a device; what is trained from here on is trained there.
    ///
    /// # Errors
    /// A GPU that is not there, that lacks something, or that has too little memory.
    pub fn on(mut self, device: &Device) -> Result<Self, FieldError> {
        if let Some(gpu) = device.open()? {
            self.session = Some(Session::new(&gpu, &mut self)?);
        }
        Ok(self)
    }

    /// Takes one optimiser step on the CPU; on a GPU up to the next multiple of 16, at most `most`, at least one.
    ///
    /// On a GPU all steps of one call have as many rays: a training that is cut elsewhere than at multiples of 16
    /// learns other bytes than one that is not.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`]; the trainer then still holds the state before the step that is named.
    /// [`FieldError::Gpu`] where the device failed.
    pub fn advance(&mut self, most: u64) -> Result<Step, FieldError> {
        match self.session.take() {
            None => self.step(),
            Some(mut session) => {
                let step = session.advance(self, most);
                self.session = Some(session);
                step
            }
        }
    }

    /// Brings the state back from where the training runs.
    pub(crate) fn sync(&mut self) -> Result<(), FieldError> {
        let Some(session) = self.session.take() else {
            return Ok(());
        };
        let synced = session.download(&mut self.state);
        self.session = Some(session);
        Ok(synced?)
    }

    /// Takes one optimiser step on the CPU.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`]; the trainer then still holds the state before the step.
    pub(crate) fn step(&mut self) -> Result<Step, FieldError> {
        let targets = self.targets();
        let shared = Shared {
            level: self.level,
            config: &self.config,
            weights: &self.state.weights,
            steps: &self.march,
            bits: &self.state.occupancy.bits,
            rays: targets.len(),
        };
        let mut chunks = std::mem::take(&mut self.chunks);
        batch::train(&shared, &targets, self.chunk_rays(), &mut chunks, &self.spares);
        let checked = self.check(&chunks).map(|()| self.learn(&chunks));
        self.chunks = chunks;
        checked?;
        let rays = targets.len() as u64;
        let found = || self.chunks.iter().map(|chunk| &chunk.found);
        let loss: f64 = found().map(|found| found.loss).sum();
        let visited: u64 = found().map(|found| found.visited).sum();
        let samples: u64 = found().map(|found| found.samples).sum();
        self.state.steps += 1;
        self.state.learn_cost(rays, visited, samples);
        if self.state.steps.is_multiple_of(UPDATE_EVERY) {
            self.update_occupancy();
            self.halve_steps();
        }
        Ok(Step {
            steps: 1,
            loss: loss / (3 * rays) as f64,
            rays,
            samples,
        })
    }

    /// Halves the steps along rays once there is a surface to find more exactly.
    pub(crate) fn halve_steps(&mut self) {
        let due = HALVED_AT.iter().filter(|at| self.state.steps >= **at).count() as u32;
        let few = self.state.samples_per_ray < FEW_SAMPLES && self.state.steps.is_multiple_of(FEW_AT);
        let wanted = due.max(self.state.halvings + u32::from(few));
        let wanted = wanted.min(self.sizes.halvings.value);
        if wanted > self.state.halvings {
            self.state.samples_per_ray *= f64::from(1_u32 << (wanted - self.state.halvings));
            self.state.halvings = wanted;
            self.march = self.sizes.steps(&self.config, wanted);
        }
    }

    /// Returns the optimiser steps taken.
    pub fn steps(&self) -> u64 {
        self.state.steps
    }

    /// Returns the field as of now; it renders where the training runs.
    ///
    /// # Errors
    /// A GPU that failed.
    pub fn field(&mut self) -> Result<Field, FieldError> {
        self.sync()?;
        let field = Field::new(
            self.config.clone(),
            self.frame.clone(),
            self.facts(),
            self.state.average.clone(),
            self.state.occupancy.bits.clone(),
        );
        match &self.session {
            None => Ok(field),
            Some(session) => field.with_gpu(session.gpu()),
        }
    }

    /// Mixes photos, cameras, poses and box into one number, to recognise a checkpoint of another training.
    pub(crate) fn fingerprint(&self) -> u64 {
        let mut sum = Fingerprint::default();
        for view in &self.views {
            let camera = &view.camera;
            sum.add([camera.width.into(), camera.height.into()]);
            let lens = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px];
            let bend = [camera.k1, camera.k2, camera.p1, camera.p2];
            sum.add(lens.iter().chain(&bend).map(|number| number.to_bits()));
            let pose: [[f64; 4]; 3] = view.cam_from_world.into();
            sum.add(pose.as_flattened().iter().map(|number| number.to_bits()));
            sum.add(view.image.words());
        }
        sum.add(
            self.frame
                .origin
                .iter()
                .chain([&self.frame.half_side])
                .map(|number| number.to_bits()),
        );
        for sighting in &self.sightings {
            sum.add([sighting.pixel, sighting.t.to_bits().into()]);
        }
        sum.0
    }

    fn facts(&self) -> Facts {
        let weights = &self.state.weights;
        let levels = weights.shapes.iter().map(|shape| LevelFacts {
            resolution: shape.resolution,
            entries: shape.entries,
            dense: shape.dense,
        });
        let parameters: usize = weights.tensors().iter().map(|(_, values)| values.len()).sum();
        Facts {
            origin: self.frame.origin,
            half_side: self.frame.half_side,
            box_reason: self.frame.reason.clone(),
            near: self.sizes.near.value * self.frame.half_side,
            far: self.sizes.far.value * self.frame.half_side,
            steps_per_ray: self.march.count as u32,
            halvings: self.state.halvings,
            levels: levels.collect(),
            sizes: self.sizes.clone(),
            trials: Vec::new(),
            parameters: parameters as u64,
            seen_share: self.state.occupancy.seen_share(),
            occupied_share: self.state.occupancy.bits.share(),
            steps: self.state.steps,
        }
    }

    /// Rays of the next step; a whole number of chunks.
    pub(crate) fn ray_count(&self) -> usize {
        let rays = f64::from(self.config.batch_samples) / self.state.samples_per_ray;
        (rays as usize).max(1).next_multiple_of(self.chunk_rays())
    }

    fn chunk_rays(&self) -> usize {
        (CHUNK_SAMPLES / self.state.samples_per_ray).clamp(4.0, 64.0) as usize
    }

    /// Draws the rays of the next step.
    pub(crate) fn targets(&self) -> Vec<Target> {
        let exposures = self.exposures();
        let rays = (0..self.ray_count()).into_par_iter();
        rays.map(|ray| self.target(ray as u64, &exposures)).collect()
    }

    pub(crate) fn target(&self, ray: u64, exposures: &[Exposure]) -> Target {
        let mut rng = Rng::new(self.seed, Purpose::Rays, self.state.steps, ray);
        let (pixel, pull) = self.aim(ray, &mut rng);
        let index = self.pixels.partition_point(|first| *first <= pixel) - 1;
        let view = &self.views[index];
        let (centre, rgb) = view.image.at((pixel - self.pixels[index]) as usize);
        Target {
            start: self.frame.ray(&view.camera, &self.world_from_cams[index], centre),
            jitter: rng.unit(),
            view: index as u32,
            rgb,
            exposure: exposures[index],
            pull,
        }
    }

    /// Draws the pixel of a ray: of every eighth, while sparse points pull, one that sees a point.
    fn aim(&self, ray: u64, rng: &mut Rng) -> (u64, Option<Pull>) {
        let weight = self.pull_at(self.state.steps, self.ray_count());
        let weight = weight.filter(|_| ray.is_multiple_of(SHARE));
        let Some(weight) = weight else {
            return (rng.below(self.pixels.last().copied().unwrap_or(0)), None);
        };
        let Sighting { pixel, t } = self.sightings[rng.below(self.sightings.len() as u64) as usize];
        let pull = place(&self.march, t).map(|place| Pull { place, weight });
        (pixel, pull)
    }

    /// Returns the weight of a pull in a step of so many rays; `None` where no point pulls, or no longer.
    pub(crate) fn pull_at(&self, step: u64, rays: usize) -> Option<f32> {
        let fading = 1.0 - step as f64 / f64::from(self.config.depth_steps);
        let weight = self.config.depth_weight * fading * SHARE as f64 / rays as f64;
        (!self.sightings.is_empty() && fading > 0.0).then_some(weight as f32)
    }

    /// Refuses a batch with a number that runs away, before any weight has changed.
    fn check(&self, chunks: &[Chunk]) -> Result<(), FieldError> {
        let bad = |tensor, place: String| FieldError::NotFinite {
            step: self.state.steps,
            tensor,
            place,
            learning_rate: self.config.learning_rate,
        };
        // A background's colour and a gain are finite whatever these are.
        for (tensor, values) in [
            ("background", &self.state.weights.background),
            ("gains", &self.state.gains),
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

    fn update_occupancy(&mut self) {
        let round = self.state.steps / UPDATE_EVERY;
        let (occupied, empty) = if round <= 16 { (4, 4) } else { (4, 16) };
        let probes = self.state.occupancy.probes(self.seed, round, occupied, empty);
        let (level, weights) = (self.level, &self.state.weights);
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
        self.state
            .occupancy
            .update(&probes, &found, self.config.min_step as f32);
    }
}

use marf_scene::{Camera, Image, Pose, Srgb};
use rayon::prelude::*;

use crate::batch::{Found, Scratch, Shared, Target};
use crate::cpu::adam::{Adam, Bias, Moments};
use crate::cpu::composite::RAW_SHIFT;
use crate::cpu::encode::{Points, Scatter, Shape};
use crate::cpu::march::Steps;
use crate::cpu::math::exp;
use crate::cpu::simd::{Block, LANES, Level, flat};
use crate::frame::{FAR, Frame};
use crate::occupancy::Occupancy;
use crate::rng::{Fingerprint, Purpose, Rng};
use crate::shade::Shade;
use crate::weights::{NET_ROW, Weights};
use crate::{Config, Facts, Field, FieldError, Gain, LevelFacts};

/// A photo to learn from.
#[derive(Clone, Debug)]
pub struct View {
    /// Id of the photo, for messages.
    pub id: String,
    /// Its camera, of the image's size.
    pub camera: Camera,
    /// Its pose: x right, y down, z forward.
    pub cam_from_world: Pose,
    /// Its pixels.
    pub image: Image<Srgb>,
}

/// What one optimiser step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Mean squared error over rays and channels of the batch, sRGB in [0, 1].
    pub loss: f64,
    /// Rays of the batch.
    pub rays: u64,
    /// Samples that were trained.
    pub samples: u64,
}

/// Adam's epsilon: gradients of a mean over the batch are about 1e-6, rounding noise is below 1e-12.
const EPSILON: f32 = 1e-12;
/// Pull of the networks' weights to zero (instant-ngp's l2).
const DECAY: f32 = 1e-6;
/// The averaged weights keep this share of themselves every step, less in the first steps.
const AVERAGE: f32 = 0.95;
/// Steps between two updates of the occupancy.
const UPDATE_EVERY: u64 = 16;
/// Samples a chunk of rays aims at: its rows then stay in the second cache.
const CHUNK_SAMPLES: f64 = 768.0;
/// Step size of log gains, as a share of the learning rate.
const GAIN_RATE: f32 = 0.1;

/// Trains a field on a set of views.
pub struct Trainer {
    pub(crate) level: Level,
    pub(crate) config: Config,
    pub(crate) seed: u64,
    views: Vec<View>,
    world_from_cams: Vec<Pose>,
    /// Number of the first pixel of every view, and of all pixels at the end.
    pixels: Vec<u64>,
    pub(crate) frame: Frame,
    pub(crate) finest: (u32, String),
    march: Steps,
    bias: Bias,
    gradients: Vec<Vec<f32>>,
    pub(crate) state: State,
}

/// All that changes in training, and nothing else.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct State {
    pub steps: u64,
    pub samples_per_ray: f64,
    pub weights: Weights,
    pub average: Weights,
    /// In the order of `Weights::tensors`.
    pub moments: Vec<Moments>,
    /// `[views, 4]` log gains; the fourth number is unused.
    pub gains: Vec<f32>,
    pub gain_moments: Moments,
    pub occupancy: Occupancy,
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
        let finest = finest(config, &frame, &views);
        let mut weights = Weights::zeros(config, finest.0);
        weights.randomise(seed);
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
        let march = Steps::new(config.near, FAR, config.min_step, config.cone);
        let state = State {
            steps: 0,
            samples_per_ray: march.count as f64,
            average: weights.clone(),
            moments: moments.collect(),
            gains: vec![0.0; views.len() * 4],
            gain_moments: Moments::new(views.len() * 4, 4),
            occupancy: Occupancy::new(config.occupancy_resolution, &frame, &views),
            weights,
        };
        Ok(Self {
            level: Level::best(),
            config: config.clone(),
            seed,
            world_from_cams: views.iter().map(|view| view.cam_from_world.inverse()).collect(),
            pixels: pixel_offsets(&views),
            views,
            frame,
            finest,
            march,
            bias: Bias::default(),
            gradients: state
                .weights
                .tables
                .iter()
                .map(|table| vec![0.0; table.len()])
                .collect(),
            state,
        })
    }

    /// Takes one optimiser step.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`]; the trainer then still holds the state before the step.
    pub fn step(&mut self) -> Result<Step, FieldError> {
        let targets = self.targets();
        let shared = Shared {
            level: self.level,
            config: &self.config,
            weights: &self.state.weights,
            steps: &self.march,
            bits: &self.state.occupancy.bits,
            rays: targets.len(),
        };
        let chunks = targets.par_chunks(self.chunk_rays());
        let found: Vec<Found> = chunks
            .map_init(Scratch::default, |scratch, rays| scratch.run(&shared, rays))
            .collect();
        self.check(&found)?;
        self.learn(&found);
        let rays = targets.len() as u64;
        let loss: f64 = found.iter().map(|found| found.loss).sum();
        let sum = |part: fn(&Found) -> u64| found.iter().map(part).sum::<u64>();
        let (visited, samples) = (sum(|found| found.visited), sum(|found| found.samples));
        self.state.steps += 1;
        let cost = (visited + 3 * samples) as f64 / (4 * rays) as f64;
        self.state.samples_per_ray = self.state.samples_per_ray * 0.8 + cost.max(1.0) * 0.2;
        if self.state.steps.is_multiple_of(UPDATE_EVERY) {
            self.update_occupancy();
        }
        Ok(Step {
            loss: loss / (3 * rays) as f64,
            rays,
            samples,
        })
    }

    /// Returns the optimiser steps taken.
    pub fn steps(&self) -> u64 {
        self.state.steps
    }

    /// Returns the field as of now.
    pub fn field(&self) -> Field {
        Field::new(
            self.config.clone(),
            self.frame.clone(),
            self.facts(),
            self.state.average.clone(),
            self.state.occupancy.bits.clone(),
        )
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
            sum.add(
                view.image
                    .pixels
                    .iter()
                    .map(|[r, g, b]| u64::from(u32::from_le_bytes([*r, *g, *b, 0]))),
            );
        }
        sum.add(
            self.frame
                .origin
                .iter()
                .chain([&self.frame.half_side])
                .map(|number| number.to_bits()),
        );
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
            near: self.config.near * self.frame.half_side,
            far: FAR * self.frame.half_side,
            steps_per_ray: self.march.count as u32,
            levels: levels.collect(),
            finest_reason: self.finest.1.clone(),
            parameters: parameters as u64,
            seen_share: self.state.occupancy.seen_share(),
            occupied_share: self.state.occupancy.bits.share(),
            steps: self.state.steps,
        }
    }

    /// Rays of the next step; a whole number of chunks.
    fn ray_count(&self) -> usize {
        let rays = f64::from(self.config.batch_samples) / self.state.samples_per_ray;
        (rays as usize).max(1).next_multiple_of(self.chunk_rays())
    }

    fn chunk_rays(&self) -> usize {
        (CHUNK_SAMPLES / self.state.samples_per_ray).clamp(4.0, 64.0) as usize
    }

    /// Draws the rays of the next step.
    fn targets(&self) -> Vec<Target> {
        let gains: Vec<f32> = self.state.gains.iter().map(|gain| exp(*gain)).collect();
        let rays = (0..self.ray_count()).into_par_iter();
        rays.map(|ray| self.target(ray as u64, &gains)).collect()
    }

    fn target(&self, ray: u64, gains: &[f32]) -> Target {
        let mut rng = Rng::new(self.seed, Purpose::Rays, self.state.steps, ray);
        let pixel = rng.below(self.pixels.last().copied().unwrap_or(0));
        let index = self.pixels.partition_point(|first| *first <= pixel) - 1;
        let view = &self.views[index];
        let within = (pixel - self.pixels[index]) as usize;
        let width = view.image.width as usize;
        let centre = [(within % width) as f64 + 0.5, (within / width) as f64 + 0.5];
        Target {
            start: self.frame.ray(&view.camera, &self.world_from_cams[index], centre),
            jitter: rng.unit(),
            view: index as u32,
            rgb: view.image.pixels[within].map(|channel| f32::from(channel) / 255.0),
            gain: [0, 1, 2].map(|channel| gains[index * 4 + channel]),
        }
    }

    /// Refuses a batch with anything that is not finite, before any weight has changed.
    fn check(&self, found: &[Found]) -> Result<(), FieldError> {
        let bad = |tensor, place: String| FieldError::NotFinite {
            step: self.state.steps,
            tensor,
            place,
            learning_rate: self.config.learning_rate,
        };
        for (chunk, found) in found.iter().enumerate() {
            if let Some(tensor) = found.bad {
                return Err(bad(tensor, format!("chunk {chunk}")));
            }
            let layers = found.density.iter().chain(&found.color);
            let layers_fine = layers
                .flat_map(|layer| flat(layer))
                .all(|value| value.is_finite());
            if !layers_fine || !found.background.iter().all(|value| value.is_finite()) {
                return Err(bad("gradient of the networks", format!("chunk {chunk}")));
            }
            if !found.loss.is_finite() {
                return Err(bad("loss", format!("chunk {chunk}")));
            }
        }
        Ok(())
    }

    /// Takes the gradients of all chunks into the weights.
    fn learn(&mut self, found: &[Found]) {
        let slowed = 1.0 + 3.0 * self.state.steps as f64 / f64::from(self.config.half_rate_steps);
        let rate = (self.config.learning_rate / slowed.sqrt()) as f32;
        let keep = AVERAGE.min((1.0 + self.state.steps as f32) / (10.0 + self.state.steps as f32));
        self.learn_tables(found, rate, keep);
        self.learn_networks(found, rate, keep);
        if self.config.gain == Gain::PerPhoto {
            self.learn_gains(found, rate * GAIN_RATE);
        }
    }

    /// One task owns one level: it adds all samples in order, then moves the table.
    fn learn_tables(&mut self, found: &[Found], rate: f32, keep: f32) {
        let (level, bias) = (self.level, &self.bias);
        let State {
            weights,
            average,
            moments,
            ..
        } = &mut self.state;
        let features = weights.features;
        let width = weights.shapes.len() * features / LANES;
        let shapes = weights.shapes.par_iter();
        let tables = weights.tables.par_iter_mut().zip(&mut average.tables);
        let tasks = shapes
            .zip(tables)
            .zip(&mut self.gradients)
            .zip(moments)
            .enumerate()
            .with_max_len(1);
        tasks.for_each(|(index, (((shape, (table, average)), gradient), moments))| {
            for found in found {
                scatter(
                    level,
                    *shape,
                    gradient,
                    found,
                    [features, index * features, width],
                );
            }
            match features {
                2 => adam::<2>(level, table, gradient, moments, [rate, 0.0], bias),
                _ => adam::<4>(level, table, gradient, moments, [rate, 0.0], bias),
            }
            blend(average, table, keep);
        });
    }

    fn learn_networks(&mut self, found: &[Found], rate: f32, keep: f32) {
        let State {
            weights,
            average,
            moments,
            ..
        } = &mut self.state;
        let tables = weights.tables.len();
        let mut sums: Vec<Vec<f32>> = Vec::new();
        for layer in 0..weights.density.layers.len() {
            sums.push(summed(found.iter().map(|found| flat(&found.density[layer]))));
        }
        for layer in 0..weights.color.layers.len() {
            sums.push(summed(found.iter().map(|found| flat(&found.color[layer]))));
        }
        sums.push(summed(found.iter().map(|found| found.background.as_slice())));
        let tensors = weights
            .tensors_mut()
            .into_iter()
            .zip(average.tensors_mut())
            .skip(tables);
        for ((((name, values), (_, average)), moments), mut gradient) in
            tensors.zip(moments.iter_mut().skip(tables)).zip(sums)
        {
            let decay = if name == "background" { 0.0 } else { DECAY };
            adam::<NET_ROW>(
                self.level,
                values,
                &mut gradient,
                moments,
                [rate, decay],
                &self.bias,
            );
            blend(average, values, keep);
        }
        weights.refresh();
        average.refresh();
    }

    /// Moves the log gains and takes their mean away: the scene keeps its own brightness.
    fn learn_gains(&mut self, found: &[Found], rate: f32) {
        let mut gradient = vec![0.0; self.state.gains.len()];
        for (view, gains) in found.iter().flat_map(|found| &found.gains) {
            for channel in 0..3 {
                gradient[*view as usize * 4 + channel] += gains[channel];
            }
        }
        let (gains, moments) = (&mut self.state.gains, &mut self.state.gain_moments);
        adam::<4>(self.level, gains, &mut gradient, moments, [rate, 0.0], &self.bias);
        let views = self.views.len() as f32;
        for channel in 0..3 {
            let mean = gains.iter().skip(channel).step_by(4).sum::<f32>() / views;
            gains
                .iter_mut()
                .skip(channel)
                .step_by(4)
                .for_each(|gain| *gain -= mean);
        }
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

/// `[features, first, width]`: features an entry, the level's first in the row, blocks a row.
fn scatter(
    level: Level,
    shape: Shape,
    gradient: &mut [f32],
    found: &Found,
    [features, first, width]: [usize; 3],
) {
    let points = Points {
        x: &found.x,
        y: &found.y,
        z: &found.z,
    };
    let rows: &[Block] = &found.features;
    debug_assert!(found.x.len().is_multiple_of(LANES));
    match features {
        2 => level.run(Scatter::<2> {
            shape,
            gradient,
            points,
            rows,
            width,
            first,
        }),
        _ => level.run(Scatter::<4> {
            shape,
            gradient,
            points,
            rows,
            width,
            first,
        }),
    }
}

/// `rates`: step size and pull to zero.
fn adam<const F: usize>(
    level: Level,
    weights: &mut [f32],
    gradient: &mut [f32],
    moments: &mut Moments,
    rates: [f32; 2],
    bias: &Bias,
) {
    level.run(Adam::<F> {
        weights,
        gradient,
        moments,
        rate: rates[0],
        epsilon: EPSILON,
        decay: rates[1],
        bias,
    });
}

/// average = keep average + (1 - keep) values.
fn blend(average: &mut [f32], values: &[f32], keep: f32) {
    for (average, value) in average.iter_mut().zip(values) {
        *average += (1.0 - keep) * (*value - *average);
    }
}

/// Sums arrays of one length in order.
fn summed<'a>(mut parts: impl Iterator<Item = &'a [f32]>) -> Vec<f32> {
    let mut sum = parts.next().unwrap_or_default().to_vec();
    for part in parts {
        for (sum, value) in sum.iter_mut().zip(part) {
            *sum += *value;
        }
    }
    sum
}

fn finest(config: &Config, frame: &Frame, views: &[View]) -> (u32, String) {
    match config.finest_resolution {
        Some(finest) => (finest, "`finest_resolution` says so".to_owned()),
        None => {
            let (cells, reason) = frame.finest(views);
            (cells.max(config.base_resolution), reason)
        }
    }
}

fn pixel_offsets(views: &[View]) -> Vec<u64> {
    let mut offsets = vec![0];
    for view in views {
        offsets.push(offsets.last().copied().unwrap_or(0) + view.image.pixels.len() as u64);
    }
    offsets
}

fn check_views(views: &[View]) -> Result<(), FieldError> {
    if views.is_empty() {
        return Err(FieldError::NoViews);
    }
    for view in views {
        let (camera, image) = (&view.camera, &view.image);
        let pixels = image.pixels.len();
        if pixels == 0 || pixels != image.width as usize * image.height as usize {
            return Err(FieldError::BadImage {
                id: view.id.clone(),
                width: image.width,
                height: image.height,
                pixels,
            });
        }
        if !camera.is_valid() || !view.cam_from_world.is_valid() {
            return Err(FieldError::BadCamera { id: view.id.clone() });
        }
        if (camera.width, camera.height) != (image.width, image.height) {
            return Err(FieldError::SizeMismatch {
                id: view.id.clone(),
                camera_width: camera.width,
                camera_height: camera.height,
                width: image.width,
                height: image.height,
            });
        }
    }
    Ok(())
}

fn check_points(points: &[[f64; 3]]) -> Result<(), FieldError> {
    match points
        .iter()
        .position(|point| !point.iter().all(|value| value.is_finite()))
    {
        Some(index) => Err(FieldError::BadPoint {
            index,
            position: points[index],
        }),
        None => Ok(()),
    }
}

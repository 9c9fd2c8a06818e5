//! One chunk of rays: forward, loss, and all gradients but those of the tables.

use crate::cpu::composite::{Gathered, NotFinite, RAW_LIMIT, Ray, colour, colour_slope};
use crate::cpu::march::{Bits, March, Steps};
use crate::cpu::math::not_finite;
use crate::cpu::simd::{Block, Level};
use crate::frame::RayStart;
use crate::shade::{Shade, Span};
use crate::weights::Weights;
use crate::{Background, Config, sh};

/// A ray with its photo and pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Where it runs; `None` where the distortion has no inverse.
    pub start: Option<RayStart>,
    /// Place within every step.
    pub jitter: f32,
    /// Number of the photo.
    pub view: u32,
    /// The pixel, sRGB in [0, 1].
    pub rgb: [f32; 3],
    /// e^(log gain) of the photo.
    pub gain: [f32; 3],
}

/// What all chunks of a step share.
#[derive(Clone, Copy)]
pub struct Shared<'a> {
    /// Instruction set.
    pub level: Level,
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

/// What a chunk found.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Positions of the trained samples, padded to a multiple of 16.
    pub x: Vec<f32>,
    /// As `x`.
    pub y: Vec<f32>,
    /// As `x`.
    pub z: Vec<f32>,
    /// Gradients of the encoded features.
    pub features: Vec<Block>,
    /// Gradients of the density network's layers.
    pub density: Vec<Vec<Block>>,
    /// Gradients of the colour network's layers.
    pub color: Vec<Vec<Block>>,
    /// Gradient of the background, `[3, 16]`.
    pub background: Vec<f32>,
    /// Gradients of the log gains, photo by photo as the rays come.
    pub gains: Vec<(u32, [f32; 3])>,
    /// Sum of squared errors over rays and channels.
    pub loss: f64,
    /// Samples that rays visited.
    pub visited: u64,
    /// Samples that were trained.
    pub samples: u64,
    /// First tensor that was not finite.
    pub bad: Option<&'static str>,
}

/// Memory of one worker.
#[derive(Default)]
pub struct Scratch {
    shade: Shade,
    spans: Vec<Span>,
    kept: Vec<u32>,
    harmonics: Vec<[f32; sh::COUNT]>,
    d_tau: Vec<f32>,
    d_rgb: Vec<[f32; 4]>,
    slope: Vec<Block>,
    spare: Vec<Block>,
}

impl Scratch {
    /// Trains on a chunk of rays.
    pub fn run(&mut self, shared: &Shared, targets: &[Target]) -> Found {
        let visited = self.march(shared, targets);
        self.shade.densities(shared.level, shared.weights);
        let mut found = Found {
            visited,
            ..Found::default()
        };
        if not_finite(&self.shade.raw) > 0 {
            found.bad = Some("raw density");
            return found;
        }
        let nothing = vec![0.0; targets.len()];
        self.shade.opacities(shared.level, &self.spans, &nothing);
        self.shade.drop_hidden(&mut self.spans, &mut self.kept);
        self.shade
            .colours(shared.level, shared.weights, &self.spans, &self.harmonics);
        let logits = self.shade.color.last().map_or(&[][..], Vec::as_slice);
        if shared.level.run(NotFinite(logits)) > 0 {
            found.bad = Some("colour logits");
            return found;
        }
        found.samples = self.kept.len() as u64;
        self.losses(shared, targets, &mut found);
        self.backward(shared, &mut found);
        found
    }

    /// Collects the samples of every ray.
    fn march(&mut self, shared: &Shared, targets: &[Target]) -> u64 {
        self.shade.samples.resize(0);
        self.spans.clear();
        self.harmonics.clear();
        for target in targets {
            let first = self.shade.samples.len();
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
                    samples: &mut self.shade.samples,
                });
            }
            let end = self.shade.samples.len();
            self.spans.push(Span { first, end });
            self.harmonics.push(harmonics);
        }
        self.shade.samples.len() as u64
    }

    /// Compares every ray with its pixel and sends the difference back to densities, colours, background, gain.
    fn losses(&mut self, shared: &Shared, targets: &[Target], found: &mut Found) {
        let n = self.shade.raw.len();
        self.d_tau.clear();
        self.d_tau.resize(n, 0.0);
        self.d_rgb.clear();
        self.d_rgb.resize(n, [0.0; 4]);
        found.background = vec![0.0; 3 * sh::COUNT];
        for (index, target) in targets.iter().enumerate() {
            if target.start.is_some() {
                self.loss(shared, index, target, found);
            }
        }
    }

    fn loss(&mut self, shared: &Shared, index: usize, target: &Target, found: &mut Found) {
        let Span { first, end } = self.spans[index];
        let shade = &self.shade;
        let ray = Ray {
            alpha: &shade.alpha[first..end],
            transmittance: &shade.transmittance[first..end],
            rgb: &shade.rgb[first..end],
            place: &shade.samples.place[first..end],
        };
        let Gathered { rgb, left } = ray.gather();
        let harmonics = &self.harmonics[index];
        let logits = shared.weights.logits_behind(harmonics);
        let behind = shared.weights.behind(shared.config.background, harmonics);
        let scale = 2.0 / (3 * shared.rays) as f32;
        let (mut slope, mut gains) = ([0.0; 3], [0.0; 3]);
        for channel in 0..3 {
            let plain = left.mul_add(behind[channel], rgb[channel]);
            let error = plain.mul_add(target.gain[channel], -target.rgb[channel]);
            found.loss += f64::from(error * error);
            slope[channel] = scale * error * target.gain[channel];
            gains[channel] = slope[channel] * plain;
        }
        let strength = shared.config.distortion as f32 / shared.rays as f32;
        let cell = 1.0 / shared.steps.count as f32;
        let (d_tau, d_rgb) = (&mut self.d_tau[first..end], &mut self.d_rgb[first..end]);
        ray.spread(slope, behind, [strength, cell], d_tau, d_rgb);
        found.gains.push((target.view, gains));
        if shared.config.background == Background::Direction {
            for channel in 0..3 {
                let value = colour(logits[channel]);
                let d_logit = left * slope[channel] * colour_slope(logits[channel], value);
                let row = &mut found.background[channel * sh::COUNT..][..sh::COUNT];
                for (gradient, harmonic) in row.iter_mut().zip(harmonics) {
                    *gradient = d_logit.mul_add(*harmonic, *gradient);
                }
            }
        }
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
        found.color = weights.color.gradients();
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
        found.density = weights.density.gradients();
        weights.density.backward(
            shared.level,
            &shade.features,
            &shade.density,
            slope,
            spare,
            &mut found.density,
        );
        if shared.level.run(NotFinite(slope)) > 0 {
            found.bad = Some("gradient of the features");
        }
        found.features.clone_from(slope);
        found.x.clone_from(&shade.samples.x);
        found.y.clone_from(&shade.samples.y);
        found.z.clone_from(&shade.samples.z);
    }
}

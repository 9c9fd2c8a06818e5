//! The loss of a batch and the first links of its gradients: kernels of `batch`.

use crate::cpu::clearance::Clearance;
use crate::cpu::composite::{Gathered, RAW_LIMIT, Ray, Runaways, colour, colour_slope};
use crate::cpu::march::Steps;
use crate::cpu::simd::{Block, InstructionSet, Isa, Kernel, Run, flat};
use crate::cpu::space::Bits;
use crate::draw::Target;
use crate::exposure::Exposure;
use crate::shade::{Shade, Span};
use crate::weights::Weights;
use crate::{Background, Config, sh};

/// What all chunks of a step share.
#[derive(Clone, Copy)]
pub struct StepContext<'a> {
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
    /// Its empty space.
    pub clearance: &'a Clearance,
    /// Rays of the whole batch: gradients are those of the mean.
    pub rays: usize,
    /// Samples of a ray that are trained, about. 0: all that show.
    pub ray_samples: u32,
    /// Weight of the distortion loss.
    pub distortion: f32,
}

/// Results of a chunk in addition to the gradients of its features.
#[derive(Clone, Debug, Default)]
pub struct ChunkSums {
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

impl ChunkSums {
    /// Returns the first gradient, but those of the features, with a number that runs away.
    pub fn runaway_gradient(&self, level: InstructionSet) -> Option<&'static str> {
        let wild = |values: &[f32]| level.run(Runaways(values));
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

/// Turns gradients of colours into those of their logits, in the first three columns. The others become 0.
pub struct LogitSlopes<'a> {
    pub logits: &'a [Block],
    pub rgb: &'a [[f32; 4]],
    pub d_rgb: &'a [[f32; 4]],
    pub slopes: &'a mut [Block],
}

impl Kernel for LogitSlopes<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let colours = self.logits.iter().zip(self.rgb).zip(self.d_rgb);
        for (slope, ((logit, rgb), d_rgb)) in self.slopes.iter_mut().zip(colours) {
            *slope = Block::ZERO;
            for (channel, slope) in slope.0[..3].iter_mut().enumerate() {
                *slope = d_rgb[channel] * colour_slope(logit.0[channel], rgb[channel]);
            }
        }
    }
}

/// Adds the gradients of optical depths to those of the raw densities, in the first column.
pub struct RawSlopes<'a> {
    pub shade: &'a Shade,
    pub d_tau: &'a [f32],
    pub slopes: &'a mut [Block],
}

impl Kernel for RawSlopes<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let samples = self.shade.raw.iter().zip(&self.shade.tau).zip(self.d_tau);
        for (slope, ((raw, tau), d_tau)) in self.slopes.iter_mut().zip(samples) {
            if *raw < RAW_LIMIT {
                slope.0[0] = d_tau.mul_add(*tau, slope.0[0]);
            }
        }
    }
}

/// The loss of every ray and its gradients.
pub struct Losses<'a> {
    pub shared: &'a StepContext<'a>,
    pub targets: &'a [Target],
    pub spans: &'a [Span],
    pub harmonics: &'a [[f32; sh::COUNT]],
    pub shade: &'a Shade,
    pub d_tau: &'a mut [f32],
    pub d_rgb: &'a mut [[f32; 4]],
    pub found: &'a mut ChunkSums,
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
        // Of a ray that sees the background alone.
        let learnt = shared.config.background == Background::Direction && target.behind.is_none();
        let logits = learnt.then(|| shared.weights.logits_behind(harmonics));
        let (behind, share) = match (target.behind, logits) {
            (Some(behind), _) => (behind.rgb, behind.share),
            (None, Some(logits)) => (logits.map(colour), 0.0),
            (None, None) => ([0.0; 3], 0.0),
        };
        let ray = Ray {
            alpha: &shade.alpha[first..end],
            transmittance: &shade.transmittance[first..end],
            rgb: &shade.rgb[first..end],
            place: &shade.samples.place[first..end],
        };
        let Gathered { rgb, left } = ray.gather();
        let scale = 2.0 / (3 * shared.rays) as f32;
        // Over black, as the pixel is: what passes, less what the pixel shows of the same colour.
        let plain = [0, 1, 2].map(|channel| (left - share).mul_add(behind[channel], rgb[channel]));
        let compared = target.exposure.compare(plain, target.rgb, scale);
        let slope = compared.colour;
        for square in compared.squares {
            self.found.loss += f64::from(square);
        }
        let strength = shared.distortion / shared.rays as f32;
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
        if let Some(logits) = logits {
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

//! The rays of a training step: which pixels they run through, drawn at random.

use marf_numeric::Rng;
use rayon::prelude::*;

use crate::cpu::math::exp;
use crate::depth::{Pull, SHARE};
use crate::exposure::{Exposure, ROW};
use crate::frame::RayStart;
use crate::rng::{Purpose, random_numbers};
use crate::training::Training;

/// How often a pixel is drawn again where a mask hides it. A ray that is still hidden then teaches nothing.
/// In photos half hidden these are 0.4 %.
pub const DRAWS: u32 = 8;

/// A ray with its photo and pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Where it starts. `None` where the distortion has no inverse, and where a mask hides the pixel.
    pub start: Option<RayStart>,
    /// Place within every step.
    pub jitter: f32,
    /// Number of the photo.
    pub view: u32,
    /// The pixel, sRGB in [0, 1].
    pub rgb: [f32; 3],
    /// Exposure of the photo.
    pub exposure: Exposure,
    /// Where its matter is, if a sparse point says so.
    pub pull: Option<Pull>,
    /// Colour behind its last sample. `None`: the background.
    pub behind: Option<Behind>,
}

/// Colour behind a ray of a photo with transparency in training. Each ray has a random one, so that neither
/// the background nor fog can replace what the photo does not show (as instant-ngp trains,
/// <https://github.com/NVlabs/instant-ngp>).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Behind {
    /// sRGB, each in [0, 1).
    pub rgb: [f32; 3],
    /// How much of it the pixel shows, in [0, 1].
    pub share: f32,
}

impl Training {
    /// Returns the exposure of every photo.
    pub fn exposures(&self) -> Vec<Exposure> {
        let (gains, offsets) = self.state.gains.split_at(self.views.len() * ROW);
        let channels = |row: &[f32]| [row[0], row[1], row[2]];
        let offsets = offsets.chunks_exact(ROW).map(channels);
        let pairs = gains
            .chunks_exact(ROW)
            .zip(offsets.chain(std::iter::repeat([0.0; 3])));
        pairs
            .map(|(row, offset)| Exposure {
                gain: channels(row).map(exp),
                offset,
            })
            .collect()
    }

    /// Draws the rays of the next step.
    pub fn targets(&self) -> Vec<Target> {
        let exposures = self.exposures();
        let rays = (0..self.ray_count()).into_par_iter();
        rays.map(|ray| self.target(ray as u64, &exposures)).collect()
    }

    /// Draws ray number `ray` of the next step. `exposures` are those of the photos.
    pub fn target(&self, ray: u64, exposures: &[Exposure]) -> Target {
        let mut rng = random_numbers(self.seed, Purpose::Rays, self.state.steps, ray);
        let (pixel, pull) = self.aim(ray, &mut rng);
        let (index, kept) = self.place_of(pixel);
        let view = &self.views[index];
        let (centre, rgb) = view.image.at(kept);
        let start = || self.frame.ray(&view.camera, &self.world_from_cams[index], centre);
        let jitter = rng.unit_f32();
        let behind = view.image.share_behind(kept).map(|share| Behind {
            rgb: [(); 3].map(|()| rng.unit_f32()),
            share,
        });
        Target {
            start: (!view.image.is_hidden(kept)).then(start).flatten(),
            jitter,
            view: index as u32,
            rgb,
            exposure: exposures[index],
            pull,
            behind,
        }
    }

    /// Draws the pixel of a ray: of every eighth, while points and distances pull, one that sees a point or has a distance.
    pub fn aim(&self, ray: u64, rng: &mut Rng) -> (u64, Option<Pull>) {
        let weight = self.pull_at(self.state.steps, self.ray_count());
        let weight = weight.filter(|_| ray.is_multiple_of(SHARE));
        let Some(weight) = weight else {
            return (self.open_pixel(rng), None);
        };
        let seen = self.observations[rng.below(self.observations.len() as u64) as usize];
        let pull = seen.place_and_share(&self.march).map(|at| Pull {
            place: at.place,
            weight: weight * at.share,
        });
        (seen.pixel, pull)
    }

    /// Draws a pixel of all photos, again where a mask hides it, at most [`DRAWS`] times.
    fn open_pixel(&self, rng: &mut Rng) -> u64 {
        let all = self.pixels.last().copied().unwrap_or(0);
        let mut pixel = 0;
        for _ in 0..DRAWS {
            pixel = rng.below(all);
            let (index, kept) = self.place_of(pixel);
            if !self.views[index].image.is_hidden(kept) {
                break;
            }
        }
        pixel
    }

    /// Returns the photo of a pixel, and which of its kept pixels it is.
    fn place_of(&self, pixel: u64) -> (usize, usize) {
        let index = self.pixels.partition_point(|first| *first <= pixel) - 1;
        (index, (pixel - self.pixels[index]) as usize)
    }
}

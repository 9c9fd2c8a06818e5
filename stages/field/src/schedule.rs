//! What changes with the steps of a training: step size, averaging, rays of a batch, length of the steps along rays.

use crate::depth::SHARE;
use crate::training::Training;

/// Steps between two updates of the occupancy.
pub const UPDATE_EVERY: u64 = 16;
/// Adam's epsilon: gradients of a mean over the batch are about 1e-6, rounding noise is below 1e-12.
pub const EPSILON: f32 = 1e-12;
/// Pull of the networks' weights to zero (instant-ngp's l2).
pub const DECAY: f32 = 1e-6;
/// Step size of the background, in learning rates: its 16 coefficients a channel have no layer to multiply them.
pub const BACKGROUND_RATE: f32 = 10.0;
/// Optimiser steps after which the steps along rays are halved: long ones find a surface sooner, short ones place it
/// better. Multiples of [`UPDATE_EVERY`].
const HALVED_AT: [u64; 3] = [640, 8_192, 65_536];
/// With fewer samples a ray than this the steps are halved at once; checked every [`FEW_AT`] steps.
const FEW_SAMPLES: f64 = 8.0;
const FEW_AT: u64 = 128;
/// Samples a chunk of rays aims at: its rows then stay in the second cache.
const CHUNK_SAMPLES: f64 = 768.0;
/// Steps between two updates of the averaged weights: every step costs a pass over all tables.
const AVERAGED_EVERY: u64 = 4;

impl Training {
    /// Returns the step size after so many steps.
    pub fn rate_at(&self, steps: u64) -> f32 {
        let slowed = 1.0 + 3.0 * steps as f64 / f64::from(self.config.half_rate_steps);
        (self.config.learning_rate / slowed.sqrt()) as f32
    }

    /// Returns the share of themselves that the averaged weights keep after so many steps, less in the first ones.
    pub fn kept_at(&self, steps: u64) -> Option<f32> {
        let step = steps as f32;
        let once = (self.config.average as f32).min((1.0 + step) / (10.0 + step));
        let steps = steps + 1;
        if steps < 4 * AVERAGED_EVERY {
            return Some(once);
        }
        let is_due = steps.is_multiple_of(AVERAGED_EVERY);
        is_due.then(|| (0..AVERAGED_EVERY).fold(1.0, |product, _| product * once))
    }

    /// Returns the weight of a pull in a step of so many rays; `None` where no point pulls, or no longer.
    pub fn pull_at(&self, step: u64, rays: usize) -> Option<f32> {
        let fading = 1.0 - step as f64 / f64::from(self.config.depth_steps);
        let weight = self.config.depth_weight * fading * SHARE as f64 / rays as f64;
        (!self.observations.is_empty() && fading > 0.0).then_some(weight as f32)
    }

    /// Halves the steps along rays once there is a surface to find more exactly.
    pub fn halve_steps(&mut self) {
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

    /// Returns the rays of the next step, a whole number of chunks.
    pub fn ray_count(&self) -> usize {
        let rays = f64::from(self.config.batch_samples) / self.state.samples_per_ray;
        (rays as usize).max(1).next_multiple_of(self.chunk_rays())
    }

    /// Returns the rays of a chunk.
    pub fn chunk_rays(&self) -> usize {
        (CHUNK_SAMPLES / self.state.samples_per_ray).clamp(4.0, 64.0) as usize
    }
}

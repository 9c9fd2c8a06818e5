//! All that changes in training, and nothing else: what a checkpoint holds.

use crate::cpu::adam::Moments;
use crate::occupancy::Occupancy;
use crate::weights::{NET_ROW, Weights};
use crate::{Config, View};

/// The state of a training.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Optimiser steps taken.
    pub steps: u64,
    /// Times that the steps along rays have been halved.
    pub halvings: u32,
    /// Running mean of the cost of a ray, in samples: decides the rays of the next batch.
    pub samples_per_ray: f64,
    /// On a GPU what `samples_per_ray` becomes once the next steps are under way: costs decide one call late, so that the
    /// device need not wait for the host. None on the CPU.
    pub late_samples_per_ray: Option<f64>,
    /// The weights.
    pub weights: Weights,
    /// Their running average: what is delivered.
    pub average: Weights,
    /// Moments of Adam, in the order of `Weights::tensors`.
    pub moments: Vec<Moments>,
    /// `[views, 4]` log gains. The fourth number is unused. Then as many offsets, if photos have them.
    pub gains: Vec<f32>,
    /// Moments of `gains`.
    pub gain_moments: Moments,
    /// Cells that may hold matter.
    pub occupancy: Occupancy,
    /// Scales of the tables' integer gradients, level by level. Empty on the CPU.
    pub scales: Vec<f32>,
}

impl State {
    /// Returns the state at step 0. `samples_per_ray` is a first guess.
    pub fn new(
        config: &Config,
        views: &[View],
        weights: Weights,
        occupancy: Occupancy,
        samples_per_ray: f64,
    ) -> Self {
        let rows = |name: &str| {
            if name.starts_with("table") {
                weights.features
            } else {
                NET_ROW
            }
        };
        let tensors = weights.tensors();
        let moments = tensors
            .iter()
            .map(|(name, values)| Moments::new(values.len(), rows(name)));
        let numbers = config.gain.numbers(views.len());
        Self {
            steps: 0,
            halvings: 0,
            samples_per_ray,
            late_samples_per_ray: None,
            average: weights.clone(),
            moments: moments.collect(),
            gains: vec![0.0; numbers],
            gain_moments: Moments::new(numbers, 4),
            occupancy,
            scales: Vec::new(),
            weights,
        }
    }

    /// Adds what the rays of a batch cost to the running mean.
    pub fn learn_cost(&mut self, rays: u64, visited: u64, trained: u64) {
        self.catch_up();
        self.samples_per_ray = with_cost(self.samples_per_ray, cost(rays, visited, trained));
    }

    /// Lets all costs that are known decide from here on.
    pub fn catch_up(&mut self) {
        self.samples_per_ray = self.late_samples_per_ray.take().unwrap_or(self.samples_per_ray);
    }
}

/// Returns the cost of a ray of a batch, in samples. A trained one counts four times a visited one.
pub fn cost(rays: u64, visited: u64, trained: u64) -> f64 {
    (visited + 3 * trained) as f64 / (4 * rays) as f64
}

/// Returns a running mean with the cost of a batch, at least one sample a ray.
pub fn with_cost(samples_per_ray: f64, cost: f64) -> f64 {
    samples_per_ray * 0.8 + cost.max(1.0) * 0.2
}

use marf_scene::{Camera, Image, Pose, Srgb};

use crate::{Config, Field, FieldError};

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

/// Trains a field on a set of views.
pub struct Trainer {
    steps: u64,
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
        let _ = (views, points, config, seed);
        todo!()
    }

    /// Takes one optimiser step.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`]; the trainer then still holds the state before the step.
    pub fn step(&mut self) -> Result<Step, FieldError> {
        todo!()
    }

    /// Returns the optimiser steps taken.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Returns the whole state. Restored into a trainer made with the same views, points, config and seed,
    /// training continues with the same bytes.
    pub fn save(&self) -> Vec<u8> {
        todo!()
    }

    /// Takes over a saved state.
    ///
    /// # Errors
    /// [`FieldError::Malformed`] or [`FieldError::OtherTraining`]; the trainer is then unchanged.
    pub fn restore(&mut self, state: &[u8]) -> Result<(), FieldError> {
        let _ = state;
        todo!()
    }

    /// Returns the field as of now.
    pub fn field(&self) -> Field {
        todo!()
    }
}

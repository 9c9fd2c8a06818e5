//! What a processor must offer so that fields are trained and rendered on it.
//!
//! Invariant: a backend gives the same bytes on every run. The CPU's bytes are the same on every machine.
//! [`Backend::id`] distinguishes all others.

use std::fmt::Debug;
use std::ops::Range;
use std::sync::Arc;

use marf_scene::{Camera, Pose};

use crate::FieldError;
use crate::model::Model;
use crate::picture::Render;
use crate::state::State;
use crate::training::Training;

/// A processor on which fields are trained and rendered.
pub trait Backend: Send + Sync {
    /// Returns the id of whatever decides the bits of its numbers. `None` if they are the same on every
    /// machine.
    fn id(&self) -> Option<&str>;

    /// Prepares a training: takes its memory and copies the state there.
    ///
    /// # Errors
    /// A device that lacks something or has too little memory.
    fn begin(self: Arc<Self>, training: &mut Training) -> Result<Box<dyn Session>, FieldError>;

    /// Prepares the rendering of a model.
    ///
    /// # Errors
    /// As [`Backend::begin`].
    fn renderer(self: Arc<Self>, model: &Model) -> Result<Arc<dyn Renderer>, FieldError>;
}

/// A training in progress on a backend.
pub trait Session: Send + Sync {
    /// Takes at least one optimiser step, at most `most`, and reports the steps whose outcome is known and
    /// not yet reported. They may be fewer, or belong to an earlier call.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`], with the state before the named step. A lost device.
    fn advance(&mut self, training: &mut Training, most: u64) -> Result<Step, FieldError>;

    /// Waits for all steps that were taken and reports those not yet reported.
    ///
    /// # Errors
    /// As [`Session::advance`].
    fn settle(&mut self, training: &mut Training) -> Result<Step, FieldError>;

    /// Copies the state from the training to the backend.
    ///
    /// # Errors
    /// A lost device.
    fn upload(&mut self, training: &Training) -> Result<(), FieldError>;

    /// Copies the state from the backend to the training. All steps are settled.
    ///
    /// # Errors
    /// A lost device.
    fn download(&self, state: &mut State) -> Result<(), FieldError>;
}

/// Renders one model on a backend.
pub trait Renderer: Debug + Send + Sync {
    /// Renders some rows of a photo of the model this renderer was made for.
    ///
    /// # Errors
    /// A lost device, or a model that is not finite.
    fn rows(
        &self,
        model: &Model,
        camera: &Camera,
        cam_from_world: &Pose,
        rows: Range<u32>,
    ) -> Result<Render, FieldError>;
}

/// What came of some steps: see [`crate::Trainer::advance`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    /// Optimiser steps.
    pub steps: u64,
    /// Mean squared error over rays and channels of the batches, sRGB in [0, 1]. 0 without a step.
    pub loss: f64,
    /// Rays of the batches.
    pub rays: u64,
    /// Samples that were trained.
    pub samples: u64,
}

impl Step {
    /// Returns the results of both together.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let steps = self.steps + other.steps;
        let sum = self.loss * self.steps as f64 + other.loss * other.steps as f64;
        Self {
            steps,
            // One of them alone stays as it is, to the bit.
            loss: match (self.steps, other.steps) {
                (_, 0) => self.loss,
                (0, _) => other.loss,
                _ => sum / steps as f64,
            },
            rays: self.rays + other.rays,
            samples: self.samples + other.samples,
        }
    }
}

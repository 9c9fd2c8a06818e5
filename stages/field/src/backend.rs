//! What a processor must offer so that fields are trained and rendered on it.
//!
//! Invariant: a backend gives the same bytes on every run. Those of the CPU are the same on every machine; those of any
//! other are told apart by [`Backend::id`].

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
    /// Returns what decides the bits of its numbers; `None` where they are the same on every machine.
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
    /// Takes at least one optimiser step, at most `most`.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`]: the state is then that before the step that is named. A lost device.
    fn advance(&mut self, training: &mut Training, most: u64) -> Result<Step, FieldError>;

    /// Copies the state from the training to the backend.
    ///
    /// # Errors
    /// A lost device.
    fn upload(&mut self, training: &Training) -> Result<(), FieldError>;

    /// Copies the state from the backend to the training.
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

/// What one call of [`crate::Trainer::advance`] did.
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

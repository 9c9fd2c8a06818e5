//! A trained field on the backend that renders it.

use std::ops::Range;
use std::sync::Arc;

use marf_scene::{Camera, Pose};

use crate::backend::{Backend, Renderer};
use crate::cpu_backend::Cpu;
use crate::model::Model;
use crate::{Config, Derived, Facts, FieldError, PhotoHistory, Render};

/// A trained field: everything needed to render.
#[derive(Clone, Debug)]
pub struct Field {
    /// Everything needed to render it.
    pub model: Model,
    renderer: Arc<dyn Renderer>,
}

impl Field {
    /// Returns a field that is rendered on `backend`.
    ///
    /// # Errors
    /// A device that lacks something or has too little memory.
    pub fn new(model: Model, backend: Arc<dyn Backend>) -> Result<Self, FieldError> {
        let renderer = backend.renderer(&model)?;
        Ok(Self { model, renderer })
    }

    /// Moves the rendering to a backend.
    ///
    /// # Errors
    /// A device that lacks something or has too little memory.
    pub fn with_backend(self, backend: Arc<dyn Backend>) -> Result<Self, FieldError> {
        Self::new(self.model, backend)
    }

    /// Returns the field as safetensors. The header's `marf` entry is JSON with box, layout, config and
    /// facts.
    ///
    /// Tensors: `table.L` `[entries * features]`, `density.I` and `color.I` `[inputs * outputs]` by rows of
    /// inputs, `background` `[3 * 16]`, `occupancy` `[side^3 / 64]` bits, x fastest.
    pub fn encode(&self) -> Vec<u8> {
        self.model.encode()
    }

    /// Reads the bytes of [`Field::encode`]. The field renders on the CPU.
    ///
    /// # Errors
    /// [`FieldError::Malformed`] names the tensor. Shapes are compared with the file before memory is
    /// allocated.
    pub fn decode(bytes: &[u8]) -> Result<Self, FieldError> {
        Self::new(Model::decode(bytes)?, Arc::new(Cpu::best()))
    }

    /// Renders a photo: `camera` with its distortion, at `cam_from_world`.
    ///
    /// Tiles run in parallel in the current pool. The pixels do not depend on its size. Pixels where the
    /// distortion has no inverse are black and empty.
    ///
    /// # Errors
    /// A GPU that failed.
    pub fn render(&self, camera: &Camera, cam_from_world: &Pose) -> Result<Render, FieldError> {
        self.rows(camera, cam_from_world, 0..camera.height)
    }

    /// Renders some rows.
    pub(crate) fn rows(
        &self,
        camera: &Camera,
        cam_from_world: &Pose,
        rows: Range<u32>,
    ) -> Result<Render, FieldError> {
        self.renderer.rows(&self.model, camera, cam_from_world, rows)
    }

    /// Returns the numbers that decided the size of the field.
    pub fn facts(&self) -> &Facts {
        &self.model.facts
    }

    /// Returns the box and the sizes at the end of the training.
    pub fn derived(&self) -> Derived {
        Derived::new(&self.model.frame, &self.model.facts.sizes)
    }

    /// Returns the field with the history that a training needs to start from it. Its bytes then include the
    /// history.
    #[must_use]
    pub fn with_learnt(mut self, learnt: PhotoHistory) -> Self {
        self.model.learnt = Some(learnt);
        self
    }

    /// Returns the photos that it was trained on, if it has them.
    pub fn learnt(&self) -> Option<&PhotoHistory> {
        self.model.learnt.as_ref()
    }

    /// Returns the hyper-parameters that it was trained with.
    pub fn config(&self) -> &Config {
        &self.model.config
    }
}

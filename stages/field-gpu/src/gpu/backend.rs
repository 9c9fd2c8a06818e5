//! A GPU as a backend: the same bytes on every run on one adapter.

use std::sync::Arc;

use super::Gpu;
use super::renderer::GpuRenderer;
use super::session::GpuSession;
use marf_field::FieldError;
use marf_field::backend::{Backend, Renderer, Session};
use marf_field::model::Model;
use marf_field::training::Training;

impl Backend for Gpu {
    fn id(&self) -> Option<&str> {
        Some(Gpu::id(self))
    }

    fn begin(self: Arc<Self>, training: &mut Training) -> Result<Box<dyn Session>, FieldError> {
        Ok(Box::new(GpuSession::new(&self, training)?))
    }

    fn renderer(self: Arc<Self>, model: &Model) -> Result<Arc<dyn Renderer>, FieldError> {
        Ok(Arc::new(GpuRenderer::new(&self, model)?))
    }
}

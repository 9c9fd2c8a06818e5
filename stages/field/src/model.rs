use marf_scene::{Camera, Pose};

use crate::{Facts, FieldError, Render};

/// A trained field: everything needed to render.
#[derive(Clone, Debug)]
pub struct Field {
    facts: Facts,
}

impl Field {
    /// Returns the field as safetensors; the header's `marf` entry is JSON with box, layout, config and facts.
    pub fn encode(&self) -> Vec<u8> {
        todo!()
    }

    /// Reads what [`Field::encode`] wrote.
    ///
    /// # Errors
    /// [`FieldError::Malformed`].
    pub fn decode(bytes: &[u8]) -> Result<Self, FieldError> {
        let _ = bytes;
        todo!()
    }

    /// Renders a photo: `camera` with its distortion, at `cam_from_world`.
    pub fn render(&self, camera: &Camera, cam_from_world: &Pose) -> Render {
        let _ = (camera, cam_from_world);
        todo!()
    }

    /// Returns what the field was sized by.
    pub fn facts(&self) -> &Facts {
        &self.facts
    }
}

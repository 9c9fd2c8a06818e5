use std::ops::Range;
use std::sync::Arc;

use marf_scene::{Camera, Pose};
use safetensors::tensor::Dtype;
use serde::{Deserialize, Serialize};

use crate::cpu::march::{Bits, Steps};
use crate::cpu::simd::Level;
use crate::frame::Frame;
use crate::gpu::Renderer;
use crate::render::render_rows;
use crate::tensors::{Reader, Writer};
use crate::weights::Weights;
use crate::{Config, Device, Facts, FieldError, Gpu, Render, Trial};

/// A trained field: everything needed to render.
#[derive(Clone, Debug)]
pub struct Field {
    pub(crate) level: Level,
    pub(crate) config: Config,
    pub(crate) frame: Frame,
    pub(crate) steps: Steps,
    pub(crate) weights: Weights,
    pub(crate) bits: Bits,
    pub(crate) facts: Facts,
    /// Where it is rendered, if not here.
    renderer: Option<Arc<Renderer>>,
}

/// The JSON in the file's header.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    /// Version of this form.
    format: u32,
    config: Config,
    frame: Frame,
    pub(crate) facts: Facts,
}

/// Raised when the meaning of the file changes.
const FORMAT: u32 = 1;

impl Field {
    pub(crate) fn new(config: Config, frame: Frame, facts: Facts, weights: Weights, bits: Bits) -> Self {
        Self {
            level: Level::best(),
            steps: facts.sizes.steps(&config, facts.halvings),
            config,
            frame,
            weights,
            bits,
            facts,
            renderer: None,
        }
    }

    /// Moves the rendering to a device.
    ///
    /// # Errors
    /// A GPU that is not there, that lacks something, or that has too little memory.
    pub fn on(self, device: &Device) -> Result<Self, FieldError> {
        match device.open()? {
            None => Ok(self),
            Some(gpu) => self.with_gpu(&gpu),
        }
    }

    pub(crate) fn with_gpu(mut self, gpu: &Arc<Gpu>) -> Result<Self, FieldError> {
        self.renderer = Some(Arc::new(Renderer::new(gpu, &self)?));
        Ok(self)
    }

    /// Returns the field as safetensors; the header's `marf` entry is JSON with box, layout, config and facts.
    ///
    /// Tensors: `table.L` `[entries * features]`, `density.I` and `color.I` `[inputs * outputs]` by rows of
    /// inputs, `background` `[3 * 16]`, `occupancy` `[side^3 / 64]` bits, x fastest.
    pub fn encode(&self) -> Vec<u8> {
        let header = Header {
            format: FORMAT,
            config: self.config.clone(),
            frame: self.frame.clone(),
            facts: self.facts.clone(),
        };
        let mut writer = Writer::default();
        for (name, values) in self.weights.tensors() {
            writer.floats(name, values);
        }
        writer.words("occupancy".to_owned(), &self.bits.words);
        // Strings and finite numbers: JSON cannot refuse them.
        writer.finish(serde_json::to_string(&header).unwrap_or_default())
    }

    /// Reads what [`Field::encode`] wrote.
    ///
    /// # Errors
    /// [`FieldError::Malformed`] names the tensor; shapes are compared with the file before memory is taken.
    pub fn decode(bytes: &[u8]) -> Result<Self, FieldError> {
        let reader = Reader::new("field", bytes)?;
        let header: Header =
            serde_json::from_str(&reader.json).map_err(|error| reader.malformed(error.to_string()))?;
        if header.format != FORMAT {
            return Err(reader.malformed(format!("format {}, this program reads {FORMAT}", header.format)));
        }
        header
            .config
            .check()
            .map_err(|error| reader.malformed(error.to_string()))?;
        let (frame, facts) = (&header.frame, &header.facts);
        let finite = frame.origin.iter().all(|value| value.is_finite());
        if !finite || !frame.half_side.is_finite() || frame.half_side <= 0.0 {
            return Err(reader.malformed(format!("box of half side {}", frame.half_side)));
        }
        let sizes = &facts.sizes;
        sizes
            .check(&header.config)
            .map_err(|error| reader.malformed(error.to_string()))?;
        for (index, shape) in Weights::shapes(&header.config, sizes).iter().enumerate() {
            let len = shape.entries as usize * header.config.features as usize;
            reader.expect(&format!("table.{index}"), Dtype::F32, len)?;
        }
        let mut weights = Weights::zeros(&header.config, sizes);
        for (name, values) in weights.tensors_mut() {
            reader.floats(&name, values)?;
        }
        weights.refresh();
        let mut bits = Bits::new(header.config.occupancy_resolution);
        reader.words("occupancy", &mut bits.words)?;
        Ok(Self::new(
            header.config,
            header.frame,
            header.facts,
            weights,
            bits,
        ))
    }

    /// Renders a photo: `camera` with its distortion, at `cam_from_world`.
    ///
    /// Tiles run in parallel in the current pool; the pixels do not depend on its size. Pixels where the
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
        match &self.renderer {
            None => Ok(render_rows(self, camera, cam_from_world, rows)),
            Some(renderer) => Ok(renderer.rows(self, camera, cam_from_world, rows)?),
        }
    }

    /// Takes down what was tried before the training.
    #[must_use]
    pub fn with_trials(mut self, trials: Vec<Trial>) -> Self {
        self.facts.trials = trials;
        self
    }

    /// Returns what the field was sized by.
    pub fn facts(&self) -> &Facts {
        &self.facts
    }
}

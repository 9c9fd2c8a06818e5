//! A trained field as data, and as bytes.

use serde::{Deserialize, Serialize};

use crate::cpu::march::Steps;
use crate::cpu::space::Bits;
use crate::frame::Frame;
use crate::tensors::{Reader, Writer, check_tables};
use crate::weights::Weights;
use crate::{Config, Facts, FieldError, PhotoHistory};

/// What a trained field consists of: everything needed to render it.
#[derive(Clone, Debug)]
pub struct Model {
    /// Hyper-parameters.
    pub config: Config,
    /// The box of the scene.
    pub frame: Frame,
    /// Steps along rays.
    pub steps: Steps,
    /// The weights.
    pub weights: Weights,
    /// Occupied cells.
    pub bits: Bits,
    /// What the field was sized by.
    pub facts: Facts,
    /// The photos that it was trained on, where a training may start from it.
    pub learnt: Option<PhotoHistory>,
}

/// The JSON in the file's header.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    /// Version of this form.
    format: u32,
    config: Config,
    frame: Frame,
    facts: Facts,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    learnt: Option<PhotoHistory>,
}

/// Raised when the meaning of the file changes.
const FORMAT: u32 = 2;

impl Model {
    /// Returns a model. The steps along rays follow from config and facts.
    pub fn new(config: Config, frame: Frame, facts: Facts, weights: Weights, bits: Bits) -> Self {
        Self {
            steps: facts.sizes.steps(&config, facts.halvings),
            config,
            frame,
            weights,
            bits,
            facts,
            learnt: None,
        }
    }

    /// Returns the field as safetensors. The header's `marf` entry is JSON with box, layout, config and
    /// facts.
    ///
    /// Tensors: `table.L` `[entries * features]`, `density.I` and `color.I` `[inputs * outputs]` by rows of
    /// inputs, `background` `[3 * 16]`, `occupancy` `[side^3 / 64]` bits, x fastest.
    pub fn encode(&self) -> Vec<u8> {
        let header = Header {
            format: FORMAT,
            config: self.config.clone(),
            frame: self.frame.clone(),
            facts: self.facts.clone(),
            learnt: self.learnt.clone(),
        };
        let mut writer = Writer::default();
        for (name, values) in self.weights.tensors() {
            writer.floats(name, values);
        }
        writer.words("occupancy".to_owned(), &self.bits.words);
        // Strings and finite numbers: JSON cannot refuse them.
        writer.finish(serde_json::to_string(&header).unwrap_or_default())
    }

    /// Reads the bytes of [`Model::encode`].
    ///
    /// # Errors
    /// [`FieldError::Malformed`] names the tensor. Shapes are compared with the file before memory is
    /// allocated.
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
        check_tables(&reader, "", &header.config, sizes)?;
        let mut weights = Weights::zeros(&header.config, sizes);
        for (name, values) in weights.tensors_mut() {
            reader.floats(&name, values)?;
        }
        weights.refresh();
        let mut bits = Bits::new(header.config.occupancy_resolution);
        reader.words("occupancy", &mut bits.words)?;
        Ok(Self {
            learnt: header.learnt,
            ..Self::new(header.config, header.frame, header.facts, weights, bits)
        })
    }
}

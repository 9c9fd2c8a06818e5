//! A trainer's state as bytes and back, exact to the bit.

use serde::{Deserialize, Serialize};

use crate::cpu::adam::Moments;
use crate::state::State;
use crate::tensors::{Reader, Writer};
use crate::{Config, FieldError, Sizes, Trainer};

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    config: Config,
    /// As text: JSON numbers of other programs lose bits above 2^53.
    seed: String,
    views: usize,
    pixels: String,
    sizes: Sizes,
    steps: u64,
    halvings: u32,
    /// Bits of the f64.
    samples_per_ray: String,
    /// The GPU that trained, none on the CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    gpu: Option<String>,
}

impl Trainer {
    /// Returns the whole state. Restored into a trainer made with the same views, points, config and seed,
    /// training continues with the same bytes.
    ///
    /// # Errors
    /// A GPU that failed.
    pub fn save(&mut self) -> Result<Vec<u8>, FieldError> {
        self.sync()?;
        let state = &self.training.state;
        let mut writer = Writer::default();
        for (name, values) in state.weights.tensors() {
            writer.floats(format!("weights.{name}"), values);
        }
        for ((name, values), moments) in state.average.tensors().into_iter().zip(&state.moments) {
            writer.floats(format!("average.{name}"), values);
            write_moments(&mut writer, &name, moments);
        }
        writer.floats("gains".to_owned(), &state.gains);
        write_moments(&mut writer, "gains", &state.gain_moments);
        if !state.scales.is_empty() {
            writer.floats("scales".to_owned(), &state.scales);
        }
        writer.floats("occupancy.density".to_owned(), &state.occupancy.density);
        writer.words("occupancy.bits".to_owned(), &state.occupancy.bits.words);
        // Strings and integers: JSON cannot refuse them.
        Ok(writer.finish(serde_json::to_string(&self.header()).unwrap_or_default()))
    }

    /// Takes over a saved state.
    ///
    /// # Errors
    /// [`FieldError::Malformed`] or [`FieldError::OtherTraining`]; the trainer is then unchanged.
    pub fn restore(&mut self, state: &[u8]) -> Result<(), FieldError> {
        let reader = Reader::new("checkpoint", state)?;
        let header: Header =
            serde_json::from_str(&reader.json).map_err(|error| reader.malformed(error.to_string()))?;
        self.same_training(&header)?;
        let bits = u64::from_str_radix(&header.samples_per_ray, 16);
        let bits = bits.map_err(|error| reader.malformed(format!("samples per ray: {error}")))?;
        let samples_per_ray = f64::from_bits(bits);
        if header.halvings > self.training.sizes.halvings.value {
            return Err(reader.malformed(format!("steps halved {} times", header.halvings)));
        }
        if !samples_per_ray.is_finite() || samples_per_ray < 1.0 {
            return Err(reader.malformed(format!("{samples_per_ray} samples per ray")));
        }
        let mut restored = self.training.state.clone();
        restored.steps = header.steps;
        restored.halvings = header.halvings;
        restored.samples_per_ray = samples_per_ray;
        read_state(&reader, &mut restored)?;
        self.training.march = self
            .training
            .sizes
            .steps(&self.training.config, restored.halvings);
        self.training.state = restored;
        self.session.upload(&self.training)
    }

    fn header(&self) -> Header {
        Header {
            config: self.training.config.clone(),
            seed: self.training.seed.to_string(),
            views: self.training.views.len(),
            pixels: format!("{:016x}", self.training.fingerprint()),
            sizes: self.training.sizes.clone(),
            steps: self.training.state.steps,
            halvings: self.training.state.halvings,
            samples_per_ray: format!("{:016x}", self.training.state.samples_per_ray.to_bits()),
            gpu: self.backend.id().map(str::to_owned),
        }
    }

    fn same_training(&self, header: &Header) -> Result<(), FieldError> {
        let own = self.header();
        let differs = |what| Err(FieldError::OtherTraining { what });
        match () {
            () if own.config != header.config => differs("config"),
            () if own.seed != header.seed => differs("seed"),
            () if own.views != header.views => differs("number of views"),
            () if own.pixels != header.pixels => differs("photos, cameras or box"),
            () if own.sizes != header.sizes => differs("size"),
            () if own.gpu != header.gpu => differs("device"),
            () => Ok(()),
        }
    }
}

fn write_moments<'a>(writer: &mut Writer<'a>, name: &str, moments: &'a Moments) {
    writer.floats(format!("first.{name}"), &moments.first);
    writer.floats(format!("second.{name}"), &moments.second);
    writer.counts(format!("count.{name}"), &moments.count);
}

fn read_moments(reader: &Reader, name: &str, moments: &mut Moments) -> Result<(), FieldError> {
    reader.floats(&format!("first.{name}"), &mut moments.first)?;
    reader.floats(&format!("second.{name}"), &mut moments.second)?;
    reader.counts(&format!("count.{name}"), &mut moments.count)
}

fn read_state(reader: &Reader, state: &mut State) -> Result<(), FieldError> {
    for (name, values) in state.weights.tensors_mut() {
        reader.floats(&format!("weights.{name}"), values)?;
    }
    for ((name, values), moments) in state.average.tensors_mut().into_iter().zip(&mut state.moments) {
        reader.floats(&format!("average.{name}"), values)?;
        read_moments(reader, &name, moments)?;
    }
    state.weights.refresh();
    state.average.refresh();
    if !state.scales.is_empty() {
        reader.floats("scales", &mut state.scales)?;
    }
    reader.floats("gains", &mut state.gains)?;
    read_moments(reader, "gains", &mut state.gain_moments)?;
    reader.floats("occupancy.density", &mut state.occupancy.density)?;
    reader.words("occupancy.bits", &mut state.occupancy.bits.words)
}

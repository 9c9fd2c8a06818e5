//! A trainer's state as bytes and back, exact to the bit.

use serde::{Deserialize, Serialize};

use crate::cpu::adam::Moments;
use crate::frame::Frame;
use crate::occupancy::{Occupancy, Refill};
use crate::state::State;
use crate::tensors::{Reader, Writer, check_tables};
use crate::{Config, FieldError, Sizes, Step, Trainer};

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    config: Config,
    /// As text: JSON numbers of other programs lose bits above 2^53.
    seed: String,
    views: usize,
    pixels: String,
    frame: Frame,
    sizes: Sizes,
    steps: u64,
    halvings: u32,
    /// Bits of the f64.
    samples_per_ray: String,
    /// As `samples_per_ray`, where the costs of the last steps do not decide yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    late_samples_per_ray: Option<String>,
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
    /// [`FieldError::Malformed`] or [`FieldError::OtherTraining`]. The trainer is then unchanged.
    pub fn restore(&mut self, state: &[u8]) -> Result<(), FieldError> {
        let reader = Reader::new("checkpoint", state)?;
        let header: Header =
            serde_json::from_str(&reader.json).map_err(|error| reader.malformed(error.to_string()))?;
        self.same_training(&header)?;
        let samples_per_ray = samples_per_ray(&reader, &header.samples_per_ray)?;
        let late = header.late_samples_per_ray.as_deref();
        let late = late
            .map(|late| self::samples_per_ray(&reader, late))
            .transpose()?;
        if header.halvings > header.sizes.halvings.value {
            return Err(reader.malformed(format!("steps halved {} times", header.halvings)));
        }
        let is_moved = header.frame != self.training.frame;
        let mut restored = if is_moved {
            self.moved(&reader, &header)?
        } else {
            self.training.state.clone()
        };
        restored.steps = header.steps;
        restored.halvings = header.halvings;
        restored.samples_per_ray = samples_per_ray;
        restored.late_samples_per_ray = late;
        read_state(&reader, &mut restored)?;
        if is_moved {
            let placed = self.training.placed(&header.sizes, restored.occupancy.clone());
            self.training
                .place(header.frame.clone(), header.sizes.clone(), placed);
            self.session = self.backend.clone().begin(&mut self.training)?;
        }
        self.training.place(header.frame, header.sizes, restored);
        self.untold = Step::default();
        self.session.upload(&self.training)
    }

    /// Returns a state of the sizes that a box fitted to the field has asked for.
    fn moved(&self, reader: &Reader, header: &Header) -> Result<State, FieldError> {
        let (training, sizes) = (&self.training, &header.sizes);
        header.frame.check(&training.views)?;
        sizes.check(&training.config)?;
        check_tables(reader, "weights.", &training.config, sizes)?;
        let occupancy = Occupancy {
            refill: Refill::WhereItShows,
            ..training.state.occupancy.clone()
        };
        let mut state = training.placed(sizes, occupancy);
        if !training.state.scales.is_empty() {
            state.scales = vec![0.0; state.weights.tables.len()];
        }
        Ok(state)
    }

    fn header(&self) -> Header {
        let bits = |number: f64| format!("{:016x}", number.to_bits());
        let state = &self.training.state;
        Header {
            config: self.training.config.clone(),
            seed: self.training.seed.to_string(),
            views: self.training.views.len(),
            pixels: format!("{:016x}", self.training.fingerprint),
            frame: self.training.frame.clone(),
            sizes: self.training.sizes.clone(),
            steps: state.steps,
            halvings: state.halvings,
            samples_per_ray: bits(state.samples_per_ray),
            late_samples_per_ray: state.late_samples_per_ray.map(bits),
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
            () if !self.training.may_hold(&header.frame, header.steps) => differs("box"),
            () if own.frame == header.frame && own.sizes != header.sizes => differs("size"),
            () if own.gpu != header.gpu => differs("device"),
            () => Ok(()),
        }
    }
}

/// Reads the bits of a cost of rays.
fn samples_per_ray(reader: &Reader, bits: &str) -> Result<f64, FieldError> {
    let bits = u64::from_str_radix(bits, 16);
    let bits = bits.map_err(|error| reader.malformed(format!("samples per ray: {error}")))?;
    let samples_per_ray = f64::from_bits(bits);
    if !samples_per_ray.is_finite() || samples_per_ray < 1.0 {
        return Err(reader.malformed(format!("{samples_per_ray} samples per ray")));
    }
    Ok(samples_per_ray)
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

//! Named tensors in the safetensors format, with one JSON text in the header.

use std::borrow::Cow;
use std::collections::HashMap;

use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, View};

use crate::weights::Weights;
use crate::{Config, FieldError, Sizes};

/// The header entry that holds our JSON. One entry only: the crate writes several in no fixed order.
const ENTRY: &str = "marf";

/// Tensors to be written as bytes. They stay where they are until the file is written.
#[derive(Default)]
pub struct Writer<'a> {
    tensors: Vec<(String, Tensor<'a>)>,
}

struct Tensor<'a> {
    values: Values<'a>,
    shape: [usize; 1],
}

enum Values<'a> {
    Floats(&'a [f32]),
    Counts(&'a [u32]),
    Words(&'a [u64]),
}

impl View for Tensor<'_> {
    fn dtype(&self) -> Dtype {
        match self.values {
            Values::Floats(_) => Dtype::F32,
            Values::Counts(_) => Dtype::U32,
            Values::Words(_) => Dtype::U64,
        }
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        match self.values {
            Values::Floats(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            Values::Counts(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            Values::Words(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        }
    }

    fn data_len(&self) -> usize {
        self.shape[0] * self.dtype().bitsize() / 8
    }
}

impl<'a> Writer<'a> {
    /// Adds f32.
    pub fn floats(&mut self, name: String, values: &'a [f32]) {
        self.add(name, values.len(), Values::Floats(values));
    }

    /// Adds u32.
    pub fn counts(&mut self, name: String, values: &'a [u32]) {
        self.add(name, values.len(), Values::Counts(values));
    }

    /// Adds u64.
    pub fn words(&mut self, name: String, values: &'a [u64]) {
        self.add(name, values.len(), Values::Words(values));
    }

    fn add(&mut self, name: String, len: usize, values: Values<'a>) {
        let shape = [len];
        self.tensors.push((name, Tensor { values, shape }));
    }

    /// Returns the file. The same tensors give the same bytes.
    pub fn finish(self, json: String) -> Vec<u8> {
        let header = HashMap::from([(ENTRY.to_owned(), json)]);
        // Every length is its slice's, so no tensor is refused and nothing else can fail in memory.
        safetensors::serialize(self.tensors, Some(header)).unwrap_or_default()
    }
}

/// Tensors in bytes. Offsets and lengths have been checked against the file.
pub struct Reader<'a> {
    what: &'static str,
    tensors: SafeTensors<'a>,
    /// The JSON text.
    pub json: String,
}

impl<'a> Reader<'a> {
    /// Reads the header.
    ///
    /// # Errors
    /// [`FieldError::Malformed`] if the bytes are not safetensors or lack our entry.
    pub fn new(what: &'static str, bytes: &'a [u8]) -> Result<Self, FieldError> {
        let malformed = |reason: String| FieldError::Malformed { what, reason };
        let tensors = SafeTensors::deserialize(bytes).map_err(|error| malformed(error.to_string()))?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|error| malformed(error.to_string()))?;
        let entry = header.metadata().as_ref().and_then(|entries| entries.get(ENTRY));
        let json = entry
            .ok_or_else(|| malformed(format!("its header has no `{ENTRY}` entry")))?
            .clone();
        Ok(Self { what, tensors, json })
    }

    /// Copies f32 into `values`, which has the length that is expected.
    ///
    /// # Errors
    /// A tensor that is missing, of another length or type, or not finite.
    pub fn floats(&self, name: &str, values: &mut [f32]) -> Result<(), FieldError> {
        let bytes = self.bytes(name, Dtype::F32, values.len())?;
        for (index, (value, bytes)) in values.iter_mut().zip(bytes.as_chunks::<4>().0).enumerate() {
            *value = f32::from_le_bytes(*bytes);
            if !value.is_finite() {
                return Err(self.malformed(format!("`{name}` is {value} at {index}")));
            }
        }
        Ok(())
    }

    /// Copies u32.
    ///
    /// # Errors
    /// As [`Reader::floats`].
    pub fn counts(&self, name: &str, values: &mut [u32]) -> Result<(), FieldError> {
        let bytes = self.bytes(name, Dtype::U32, values.len())?;
        for (value, bytes) in values.iter_mut().zip(bytes.as_chunks::<4>().0) {
            *value = u32::from_le_bytes(*bytes);
        }
        Ok(())
    }

    /// Copies u64.
    ///
    /// # Errors
    /// As [`Reader::floats`].
    pub fn words(&self, name: &str, values: &mut [u64]) -> Result<(), FieldError> {
        let bytes = self.bytes(name, Dtype::U64, values.len())?;
        for (value, bytes) in values.iter_mut().zip(bytes.as_chunks::<8>().0) {
            *value = u64::from_le_bytes(*bytes);
        }
        Ok(())
    }

    /// Checks that a tensor has `len` numbers, before memory is allocated for it.
    ///
    /// # Errors
    /// As [`Reader::floats`].
    pub fn expect(&self, name: &str, dtype: Dtype, len: usize) -> Result<(), FieldError> {
        self.bytes(name, dtype, len).map(|_| ())
    }

    /// Wraps a reason.
    pub fn malformed(&self, reason: String) -> FieldError {
        FieldError::Malformed {
            what: self.what,
            reason,
        }
    }

    fn bytes(&self, name: &str, dtype: Dtype, len: usize) -> Result<&'a [u8], FieldError> {
        let tensor = self.tensors.tensor(name);
        let tensor = tensor.map_err(|_| self.malformed(format!("tensor `{name}` is missing")))?;
        if tensor.dtype() != dtype || tensor.shape() != [len] {
            let found = format!("{:?} {:?}", tensor.dtype(), tensor.shape());
            return Err(self.malformed(format!("tensor `{name}` is {found}, expected {dtype:?} [{len}]")));
        }
        Ok(tensor.data())
    }
}

/// Checks the tables of a file by name and length before memory is taken.
///
/// # Errors
/// [`FieldError::Malformed`] names the tensor.
pub fn check_tables(reader: &Reader, prefix: &str, config: &Config, sizes: &Sizes) -> Result<(), FieldError> {
    for (index, shape) in Weights::shapes(config, sizes).iter().enumerate() {
        let len = shape.entries as usize * config.features as usize;
        reader.expect(&format!("{prefix}table.{index}"), Dtype::F32, len)?;
    }
    Ok(())
}

//! Named tensors in the safetensors format, with one JSON text beside them.

use std::collections::HashMap;

use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};

use crate::FieldError;

/// The header entry that holds our JSON. One entry only: the crate writes several in no fixed order.
const ENTRY: &str = "marf";

/// Tensors on their way into bytes.
#[derive(Default)]
pub struct Writer {
    tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)>,
}

impl Writer {
    /// Adds f32.
    pub fn floats(&mut self, name: String, values: &[f32]) {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        self.tensors
            .push((name, Dtype::F32, vec![values.len()], bytes.collect()));
    }

    /// Adds u32.
    pub fn counts(&mut self, name: String, values: &[u32]) {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        self.tensors
            .push((name, Dtype::U32, vec![values.len()], bytes.collect()));
    }

    /// Adds u64.
    pub fn words(&mut self, name: String, values: &[u64]) {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        self.tensors
            .push((name, Dtype::U64, vec![values.len()], bytes.collect()));
    }

    /// Returns the file; the same tensors give the same bytes.
    pub fn finish(self, json: String) -> Vec<u8> {
        let views = self.tensors.iter().filter_map(|(name, dtype, shape, bytes)| {
            let view = TensorView::new(*dtype, shape.clone(), bytes).ok()?;
            Some((name.clone(), view))
        });
        let header = HashMap::from([(ENTRY.to_owned(), json)]);
        // The lengths were counted above, so no view is refused and nothing else can fail in memory.
        safetensors::serialize(views, Some(header)).unwrap_or_default()
    }
}

/// Tensors in bytes; offsets and lengths have been checked against the file.
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
    /// [`FieldError::Malformed`] where the bytes are no safetensors or lack our entry.
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

    /// Checks that a tensor has so many numbers, before memory is taken for it.
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

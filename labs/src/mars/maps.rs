//! Reads maps of `bootstrap`.

use std::{fs, path::Path};

use crate::output::Result;

/// An array of f32 in rows.
pub struct Array {
    pub columns: u32,
    pub values: Vec<f32>,
}

/// Reads an array as `bootstrap` writes it: a header of whole blocks of 64 bytes, then f32 LE.
pub fn array(path: &Path) -> Result<Array> {
    let bytes = fs::read(path)?;
    let length = bytes.get(8..10).ok_or("no array")?;
    let (header, values) = bytes.split_at(10 + usize::from(u16::from_le_bytes([length[0], length[1]])));
    let header = String::from_utf8_lossy(header);
    let shape = header
        .split_once("'shape': (")
        .and_then(|(_, shape)| shape.split_once(",)"));
    let (shape, _) = shape.ok_or_else(|| format!("{}: no shape", path.display()))?;
    let columns = shape.rsplit(", ").next().ok_or("no columns")?.parse()?;
    let (values, _) = values.as_chunks::<4>();
    let values = values.iter().map(|value| f32::from_le_bytes(*value));
    Ok(Array {
        columns,
        values: values.collect(),
    })
}

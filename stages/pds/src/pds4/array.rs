//! The array of pixels that a PDS4 label describes.

use roxmltree::Node;

use super::node::{PDS, child, children, number_at, text_at};
use crate::label::{Array, BandStorage, Quantity, Sample, SampleKind};
use crate::values;

/// Keys of values that mean no light: no value, or less than can be stored.
const MISSING: [&str; 7] = [
    "missing_constant",
    "invalid_constant",
    "unknown_constant",
    "not_applicable_constant",
    "error_constant",
    "low_instrument_saturation",
    "low_representation_saturation",
];
/// Keys of values that mean more light than can be stored.
const SATURATED: [&str; 3] = [
    "saturated_constant",
    "high_instrument_saturation",
    "high_representation_saturation",
];

/// Returns the first array of two or three dimensions; `None` if there is none that can be read.
pub(super) fn read(root: Node<'_, '_>) -> Option<Array> {
    let area = child(root, PDS, "File_Area_Observational")?;
    let node = ["Array_2D_Image", "Array_3D_Image"]
        .iter()
        .find_map(|name| child(area, PDS, name))?;
    let element = child(node, PDS, "Element_Array")?;
    let sample = sample(&text_at(element, &[(PDS, "data_type")])?)?;
    let (shape, order) = axes(node)?;
    let number = |name| number_at(element, &[(PDS, name)]);
    let scaling = (
        number("scaling_factor").unwrap_or(1.0),
        number("value_offset").unwrap_or(0.0),
    );
    let constants = child(node, PDS, "Special_Constants");
    Some(Array {
        file: text_at(area, &[(PDS, "File"), (PDS, "file_name")]),
        offset: number_at(node, &[(PDS, "offset")]).filter(|offset| *offset >= 0.0)? as u64,
        shape,
        order,
        sample,
        prefix_bytes: 0,
        suffix_bytes: 0,
        bits: None,
        scaling: (scaling != (1.0, 0.0)).then_some(scaling),
        missing: constants
            .map(|node| constants_of(node, &MISSING, sample))
            .unwrap_or_default(),
        saturated: constants
            .map(|node| constants_of(node, &SATURATED, sample))
            .unwrap_or_default(),
        companded_by: None,
        quantity: Quantity::Counts,
    })
}

fn constants_of(node: Node<'_, '_>, names: &[&str], sample: Sample) -> Vec<f64> {
    let constant = |name: &&str| values::constant(&text_at(node, &[(PDS, name)])?, sample);
    names.iter().filter_map(constant).collect()
}

fn axes(node: Node<'_, '_>) -> Option<([u32; 3], BandStorage)> {
    let mut axes: Vec<(u32, String, u32)> = Vec::new();
    for axis in children(node, PDS, "Axis_Array").take(4) {
        let side = |name| {
            values::integer(&text_at(axis, &[(PDS, name)])?).and_then(|value| u32::try_from(value).ok())
        };
        axes.push((
            side("sequence_number")?,
            text_at(axis, &[(PDS, "axis_name")])?,
            side("elements")?,
        ));
    }
    axes.sort();
    let names: Vec<&str> = axes.iter().map(|axis| axis.1.as_str()).collect();
    let order = match names.as_slice() {
        ["Line", "Sample"] | ["Band", "Line", "Sample"] => BandStorage::BandSequential,
        ["Line", "Band", "Sample"] => BandStorage::LineInterleaved,
        ["Line", "Sample", "Band"] => BandStorage::PixelInterleaved,
        _ => return None,
    };
    let length = |name: &str| axes.iter().find(|axis| axis.1 == name).map(|axis| axis.2);
    Some((
        [length("Band").unwrap_or(1), length("Line")?, length("Sample")?],
        order,
    ))
}

pub(super) fn sample(data_type: &str) -> Option<Sample> {
    let (kind, rest) = if let Some(rest) = data_type.strip_prefix("Unsigned") {
        (SampleKind::Unsigned, rest)
    } else if let Some(rest) = data_type.strip_prefix("Signed") {
        (SampleKind::Signed, rest)
    } else {
        (SampleKind::Float, data_type.strip_prefix("IEEE754")?)
    };
    let (big_endian, size) = match (rest.strip_prefix("MSB"), rest.strip_prefix("LSB")) {
        (Some(size), _) => (true, size),
        (_, Some(size)) => (false, size),
        _ => (true, rest),
    };
    let bytes = match (kind, size) {
        (SampleKind::Float, "Single") => 4,
        (SampleKind::Float, "Double") => 8,
        (SampleKind::Unsigned | SampleKind::Signed, "Byte") => 1,
        (SampleKind::Unsigned | SampleKind::Signed, "2") => 2,
        (SampleKind::Unsigned | SampleKind::Signed, "4") => 4,
        (SampleKind::Unsigned | SampleKind::Signed, "8") => 8,
        _ => return None,
    };
    Some(Sample {
        kind,
        bytes,
        big_endian,
    })
}

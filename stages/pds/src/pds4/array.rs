//! The array of pixels that a PDS4 label describes.

use roxmltree::Node;

use super::node::{PDS, child, children, number_at, text_at};
use super::{display, scaling};
use crate::label::{Array, BandStorage, FileFacts, Sample, SampleKind};
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

/// Elements that describe a photo, the usual ones first.
const ARRAYS: [&[&str]; 2] = [
    &["Array_2D_Image", "Array_3D_Image"],
    &["Array_2D", "Array_3D", "Array"],
];

/// Returns the first array, in the order of the label, that can be read as a photo. `None` if there is none. A mask
/// is taken only if there is nothing else.
pub(super) fn read(root: Node<'_, '_>, notes: &mut Vec<String>) -> Option<Array> {
    let areas = children(root, PDS, "File_Area_Observational");
    let nodes: Vec<_> = areas.flat_map(|area| area.children()).collect();
    let named = |names: &[&str]| -> Vec<Node<'_, '_>> {
        let is_array = |node: &&Node<'_, '_>| names.iter().any(|name| node.has_tag_name((PDS, *name)));
        nodes.iter().filter(is_array).copied().collect()
    };
    let arrays = ARRAYS.into_iter().flat_map(named);
    let (masks, photos): (Vec<_>, Vec<_>) = arrays.partition(|node| is_mask(*node));
    let all = photos.len() + masks.len();
    let (node, mut array) = photos
        .into_iter()
        .chain(masks)
        .find_map(|node| Some((node, one(node)?)))?;
    if all > 1 {
        let name = array_name(node).unwrap_or_else(|| "the first".to_owned());
        notes.push(format!("label describes {all} arrays: {name} is read"));
    }
    display::set_directions(root, text_at(node, &[(PDS, "local_identifier")]), &mut array);
    Some(array)
}

/// Returns size and MD5 of the file of an array, where the label has them.
pub(super) fn whole_file(root: Node<'_, '_>, array: &Array) -> FileFacts {
    let files = children(root, PDS, "File_Area_Observational").filter_map(|area| child(area, PDS, "File"));
    let is_named = |file: &Node<'_, '_>| text_at(*file, &[(PDS, "file_name")]) == array.file;
    files
        .filter(is_named)
        .map(|file| FileFacts {
            bytes: number_at(file, &[(PDS, "file_size")]).map(|bytes| bytes as u64),
            md5: text_at(file, &[(PDS, "md5_checksum")]).map(|md5| md5.to_ascii_lowercase()),
        })
        .next()
        .unwrap_or_default()
}

fn array_name(node: Node<'_, '_>) -> Option<String> {
    text_at(node, &[(PDS, "name")]).or_else(|| text_at(node, &[(PDS, "local_identifier")]))
}

/// Whether an array, or the file that holds it, is called a mask.
fn is_mask(node: Node<'_, '_>) -> bool {
    let file = node
        .parent()
        .and_then(|area| text_at(area, &[(PDS, "File"), (PDS, "file_name")]));
    [array_name(node), file]
        .into_iter()
        .flatten()
        .any(|name| name.to_ascii_lowercase().contains("mask"))
}

fn one(node: Node<'_, '_>) -> Option<Array> {
    let order = text_at(node, &[(PDS, "axis_index_order")]);
    if order.is_some_and(|order| !order.eq_ignore_ascii_case("Last Index Fastest")) {
        return None;
    }
    let element = child(node, PDS, "Element_Array")?;
    let sample = sample(&text_at(element, &[(PDS, "data_type")])?)?;
    let (shape, order) = axes(node)?;
    let number = |name| number_at(element, &[(PDS, name)]);
    let scaling = (
        number("scaling_factor").unwrap_or(1.0),
        number("value_offset").unwrap_or(0.0),
    );
    let constants = child(node, PDS, "Special_Constants");
    let mut array = Array {
        file: text_at(node.parent()?, &[(PDS, "File"), (PDS, "file_name")]),
        offset: number_at(node, &[(PDS, "offset")]).filter(|offset| *offset >= 0.0)? as u64,
        shape,
        order,
        sample,
        scaling: if scaling == (1.0, 0.0) {
            Vec::new()
        } else {
            vec![scaling]
        },
        missing: constants
            .map(|node| constants_of(node, &MISSING, sample))
            .unwrap_or_default(),
        saturated: constants
            .map(|node| constants_of(node, &SATURATED, sample))
            .unwrap_or_default(),
        ..Array::default()
    };
    scaling::apply_unit(element, &mut array);
    Some(array)
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

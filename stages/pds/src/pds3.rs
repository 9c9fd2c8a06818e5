//! PDS3, ODL and VICAR labels, attached or detached, read as [`Label`].

use crate::camera::{CameraError, RawEntrance, RawModel};
use crate::label::{
    Array, BandStorage, BayerPhase, FramePose, Label, LineDirection, Quantity, Sample, SampleDirection,
    SampleKind, ordered_counter, same_place,
};
use crate::odl::{Group, Value};
use crate::values;

/// Keys of values that mean no light: no value, or less than can be stored.
const MISSING: [&str; 8] = [
    "MISSING_CONSTANT",
    "INVALID_CONSTANT",
    "NULL_CONSTANT",
    "UNKNOWN_CONSTANT",
    "NOT_APPLICABLE_CONSTANT",
    "CORE_NULL",
    "LOW_INSTR_SATURATION",
    "LOW_REPR_SATURATION",
];
/// Keys of values that mean more light than can be stored.
const SATURATED: [&str; 2] = ["HIGH_INSTR_SATURATION", "HIGH_REPR_SATURATION"];

/// Returns the contents of a label. Sizes come from OBJECT = IMAGE only: elsewhere `LINES` is the requested number.
pub fn label(odl: &Group) -> Label {
    let state = odl.find(&["INSTRUMENT_STATE_PARMS"]);
    let mut label = Label {
        product: top(odl, "PRODUCT_ID").and_then(values::known),
        sol: top(odl, "PLANET_DAY_NUMBER").and_then(values::sol),
        instrument: top(odl, "INSTRUMENT_ID").and_then(values::known),
        filter: state.and_then(|state| text(state, "FILTER_NUMBER").or_else(|| text(state, "FILTER_NAME"))),
        thumbnail: top(odl, "IMAGE_TYPE").is_some_and(|kind| kind.eq_ignore_ascii_case("THUMBNAIL")),
        focal_mm: state
            .and_then(|state| values::number(state.text("FOCAL_LENGTH")?))
            .filter(|focal| *focal > 0.0),
        averaged: averaged(odl),
        array: array(odl).or_else(|| vicar_array(odl)),
        ..Label::default()
    };
    label.size = label.array.as_ref().map(|array| (array.shape[2], array.shape[1]));
    label.mosaic = mosaic(odl);
    add_camera(odl, &mut label);
    label
}

/// Returns the reason if a label is not of a photo.
pub fn no_photo(odl: &Group) -> Option<String> {
    let image = odl.find(&["IMAGE", "IMAGE_DATA"]);
    if image.is_none() && odl.text("NL").is_none() {
        let objects: Vec<&str> = odl
            .groups
            .iter()
            .map(|group| group.name.as_str())
            .take(3)
            .collect();
        return Some(format!("a label without an image: it describes {objects:?}"));
    }
    let derived = odl
        .find(&["DERIVED_IMAGE_PARMS"])
        .and_then(|group| text(group, "DERIVED_IMAGE_TYPE"));
    derived
        .filter(|kind| kind != "IMAGE")
        .map(|kind| format!("a product of type {kind} holds no photo"))
}

/// Returns the value of a key of the label itself. VICAR has those in a property.
fn identification<'a>(odl: &'a Group, key: &str) -> Option<&'a Value> {
    odl.get(key).or_else(|| odl.find(&["IDENTIFICATION"])?.get(key))
}

fn top<'a>(odl: &'a Group, key: &str) -> Option<&'a str> {
    identification(odl, key)?.text()
}

fn text(group: &Group, key: &str) -> Option<String> {
    values::known(group.text(key)?)
}

fn unsigned(group: &Group, key: &str) -> Option<u32> {
    values::integer(group.text(key)?).and_then(|value| u32::try_from(value).ok())
}

/// Returns the side of the boxes of detector pixels that were averaged, if both sides are equal.
fn averaged(odl: &Group) -> u32 {
    let places = odl.descendants();
    let box_of = |group: &&Group| {
        let sides = (
            unsigned(group, "PIXEL_AVERAGING_HEIGHT")?,
            unsigned(group, "PIXEL_AVERAGING_WIDTH")?,
        );
        (sides.0 == sides.1).then_some(sides.0)
    };
    let measured = |group: &&&Group| !group.name.contains("REQUEST");
    let side = places.iter().filter(measured).find_map(box_of);
    side.filter(|side| (1..=64).contains(side)).unwrap_or(1)
}

/// Returns the phase of the colour mosaic, if by the label the pixels are not interpolated.
fn mosaic(odl: &Group) -> Option<BayerPhase> {
    let state = odl.find(&["INSTRUMENT_STATE_PARMS"])?;
    let raw = text(state, "BAYER_METHOD").is_some_and(|method| method == "RAW_BAYER");
    let pattern = text(state, "CFA_TYPE").is_none_or(|pattern| pattern == "BAYER_RGGB");
    if !(raw && pattern) {
        return None;
    }
    let image = odl.find(&["IMAGE", "IMAGE_DATA"])?;
    let first = |key| unsigned(image, key).unwrap_or(1).max(1) - 1;
    Some(BayerPhase {
        line: first("FIRST_LINE"),
        sample: first("FIRST_LINE_SAMPLE"),
    })
}

fn add_camera(odl: &Group, label: &mut Label) {
    let names = ["GEOMETRIC_CAMERA_MODEL", "GEOMETRIC_CAMERA_MODEL_PARMS"];
    let Some(group) = odl.find(&names) else {
        label.notes.push("label has no camera".to_owned());
        return;
    };
    let frame = text(group, "REFERENCE_COORD_SYSTEM_NAME");
    match (model(group), frame) {
        (Err(error), _) => label.refuse_camera(&error),
        (Ok(_), None) => label
            .notes
            .push("label has no usable camera: its frame is not named".to_owned()),
        (Ok(raw), Some(frame)) => {
            let pose = frame_pose(odl, group, &frame, &mut label.notes);
            let counter = ordered_counter(&motion_counter(odl));
            label.set_camera(&raw, frame, pose, counter);
        }
    }
}

fn model(group: &Group) -> Result<RawModel, CameraError> {
    const KEYS: [&str; 7] = [
        "MODEL_COMPONENT_1",
        "MODEL_COMPONENT_2",
        "MODEL_COMPONENT_3",
        "MODEL_COMPONENT_4",
        "MODEL_COMPONENT_5",
        "MODEL_COMPONENT_6",
        "MODEL_COMPONENT_7",
    ];
    let vector = |index: usize, letter| {
        let value = group.get(KEYS[index]).and_then(Value::numbers::<3>);
        value.ok_or(CameraError::Number(letter))
    };
    let kind = text(group, "MODEL_TYPE").unwrap_or_default();
    let cahv = [vector(0, "C")?, vector(1, "A")?, vector(2, "H")?, vector(3, "V")?];
    let distorted = || Ok(Some([vector(4, "O")?, vector(5, "R")?]));
    let (distortion, entrance) = match kind.as_str() {
        "CAHV" => (None, None),
        "CAHVOR" => (distorted()?, None),
        "CAHVORE" => (distorted()?, Some(entrance(group, vector(6, "E")?)?)),
        _ => return Err(CameraError::Number("a model type of CAHV, CAHVOR or CAHVORE")),
    };
    Ok(RawModel {
        cahv,
        distortion,
        entrance,
    })
}

/// Returns terms, type and parameter of a CAHVORE (components 7 to 9).
fn entrance(group: &Group, terms: [f64; 3]) -> Result<RawEntrance, CameraError> {
    let kind = group.text("MODEL_COMPONENT_8").and_then(values::integer);
    let kind = kind.ok_or(CameraError::Number("the type of the CAHVORE"))?;
    let parameter = group.text("MODEL_COMPONENT_9").and_then(values::number);
    let parameter = parameter.or((kind != 3).then_some(0.0));
    Ok(RawEntrance {
        terms,
        kind,
        parameter: parameter.ok_or(CameraError::Number("the parameter of the CAHVORE"))?,
    })
}

/// Returns the rover's counters by name. Without names, in the order of all labels: SITE, DRIVE, POSE, …
fn motion_counter(odl: &Group) -> Vec<(String, i64)> {
    let values = identification(odl, "ROVER_MOTION_COUNTER");
    let names = identification(odl, "ROVER_MOTION_COUNTER_NAME");
    counters(values, names)
}

fn counters(values: Option<&Value>, names: Option<&Value>) -> Vec<(String, i64)> {
    let values = values.map(Value::items).unwrap_or_default();
    let names = names.map(Value::items).unwrap_or_default();
    let name = |index: usize| match names.get(index).and_then(Value::text) {
        Some(name) => name.to_ascii_uppercase(),
        None => ["SITE", "DRIVE", "POSE"]
            .get(index)
            .copied()
            .unwrap_or("OTHER")
            .to_owned(),
    };
    let entry = |(index, value): (usize, &Value)| Some((name(index), values::integer(value.text()?)?));
    let all: Option<Vec<_>> = values.iter().enumerate().map(entry).collect();
    all.unwrap_or_default()
}

/// Returns the camera frame's pose in its site, from the group of the same name and counters.
fn frame_pose(odl: &Group, camera: &Group, frame: &str, notes: &mut Vec<String>) -> FramePose {
    if frame == "SITE_FRAME" {
        return FramePose::IsSite;
    }
    let is = |group: &Group, key: &str, word: &str| group.text(key) == Some(word);
    let names = camera.get("COORDINATE_SYSTEM_INDEX_NAME");
    let wanted = match counters(camera.get("REFERENCE_COORD_SYSTEM_INDEX"), names) {
        given if given.is_empty() => motion_counter(odl),
        given => given,
    };
    let places = |group: &&&Group| {
        let names = group.get("COORDINATE_SYSTEM_INDEX_NAME");
        let own = counters(group.get("COORDINATE_SYSTEM_INDEX"), names);
        is(group, "COORDINATE_SYSTEM_NAME", frame)
            && is(group, "REFERENCE_COORD_SYSTEM_NAME", "SITE_FRAME")
            && same_place(&own, &wanted)
            && same_place(
                &counters(group.get("REFERENCE_COORD_SYSTEM_INDEX"), None),
                &wanted,
            )
    };
    let below = odl.descendants();
    let Some(group) = below.iter().find(places) else {
        return FramePose::Unknown;
    };
    if is(group, "QUATERNION_MEASUREMENT_METHOD", "TILT_ONLY") {
        notes.push("the rover's yaw was not measured (TILT_ONLY)".to_owned());
    }
    let quaternion = group
        .get("ORIGIN_ROTATION_QUATERNION")
        .and_then(Value::numbers::<4>);
    let offset = group.get("ORIGIN_OFFSET_VECTOR").and_then(Value::numbers::<3>);
    match (quaternion, offset) {
        (Some(quaternion), Some(offset)) => FramePose::Given { quaternion, offset },
        _ => FramePose::Unknown,
    }
}

fn array(odl: &Group) -> Option<Array> {
    let described = described(odl);
    let image = described.find(&["IMAGE"]).or_else(|| odl.find(&["IMAGE"]))?;
    let (file, offset) = pointer(described)?;
    let file = file.or_else(|| text(described, "FILE_NAME"));
    let bits = unsigned(image, "SAMPLE_BITS")?;
    let stored = sample(image.text("SAMPLE_TYPE")?, bits)?;
    let order = match text(image, "BAND_STORAGE_TYPE").as_deref() {
        None | Some("BAND_SEQUENTIAL") => BandStorage::BandSequential,
        Some("LINE_INTERLEAVED") => BandStorage::LineInterleaved,
        Some("SAMPLE_INTERLEAVED") => BandStorage::PixelInterleaved,
        Some(_) => return None,
    };
    let number = |key| image.text(key).and_then(values::number);
    let scaling = (
        number("SCALING_FACTOR").unwrap_or(1.0),
        number("OFFSET").unwrap_or(0.0),
    );
    let scaling = (scaling != (1.0, 0.0)).then_some(scaling);
    Some(Array {
        file,
        offset,
        shape: [
            unsigned(image, "BANDS").unwrap_or(1),
            unsigned(image, "LINES")?,
            unsigned(image, "LINE_SAMPLES")?,
        ],
        order,
        sample: stored,
        prefix_bytes: unsigned(image, "LINE_PREFIX_BYTES").unwrap_or(0),
        suffix_bytes: unsigned(image, "LINE_SUFFIX_BYTES").unwrap_or(0),
        bits: image.text("SAMPLE_BIT_MASK").and_then(values::mask_bits),
        scaling,
        missing: constants(image, &MISSING, stored),
        saturated: constants(image, &SATURATED, stored),
        companded_by: companded_by(odl),
        quantity: quantity(odl),
        lines: LineDirection::default(),
        samples: SampleDirection::default(),
    })
}

/// Returns the group that points to the image: the label itself, or an `OBJECT = FILE` (or `UNCOMPRESSED_FILE`) in it.
fn described(odl: &Group) -> &Group {
    let points = |group: &&Group| group.get("^IMAGE").is_some();
    let mut files = odl.descendants();
    files.retain(|group| ["FILE", "UNCOMPRESSED_FILE"].contains(&group.name.as_str()));
    std::iter::once(odl).chain(files).find(points).unwrap_or(odl)
}

fn constants(image: &Group, names: &[&str], sample: Sample) -> Vec<f64> {
    let constant = |name: &&str| values::constant(image.text(name)?, sample);
    names.iter().filter_map(constant).collect()
}

/// Returns the look-up table whose codes the pixels are. With `HARDWARE_INVERTED` and the like they are counts again.
fn companded_by(odl: &Group) -> Option<String> {
    let all = odl.descendants();
    let places = all.iter().filter(|group| !group.name.contains("REQUEST"));
    let known = |key: &str| places.clone().find_map(|group| text(group, key));
    let method = known("SAMPLE_BIT_METHOD")?;
    let codes = ["HARDWARE", "SOFTWARE"]
        .iter()
        .any(|word| method.eq_ignore_ascii_case(word));
    codes
        .then(|| known("INVERSE_LUT_FILE_NAME").or_else(|| known("SAMPLE_BIT_MODE_ID")))
        .flatten()
}

/// Returns the quantity of the values, by their unit.
fn quantity(odl: &Group) -> Quantity {
    let derived = odl.find(&["DERIVED_IMAGE_PARMS"]);
    let unit = derived
        .and_then(|group| text(group, "UNITS"))
        .or_else(|| text(odl, "UNITS"));
    let unit = unit.unwrap_or_default().to_ascii_uppercase().replace("**", "^");
    match unit.as_str() {
        "W/M^2/SR/NM" | "W/M^2/NM/SR" => Quantity::Radiance,
        _ => Quantity::Counts,
    }
}

/// Returns file and offset of a group's `^IMAGE = 15` (record from 1), `8641 <BYTES>` (byte from 1), `("F.IMG", 15)`, `"F.IMG"`.
fn pointer(odl: &Group) -> Option<(Option<String>, u64)> {
    let value = odl.get("^IMAGE")?;
    let items = value.items();
    let (file, place) = match items {
        [file, place] => (file.text(), Some(place)),
        [single] if single.text().and_then(values::integer).is_some() => (None, Some(single)),
        [file] => (file.text(), None),
        _ => return None,
    };
    let first = match place {
        None => 1,
        Some(place) => u64::try_from(values::integer(place.text()?)?)
            .ok()
            .filter(|first| *first > 0)?,
    };
    let in_bytes = matches!(place, Some(Value::Unit(_, unit)) if unit.eq_ignore_ascii_case("BYTES"));
    let unit = if in_bytes || first == 1 {
        1
    } else {
        u64::from(unsigned(odl, "RECORD_BYTES")?)
    };
    Some((file.map(str::to_owned), (first - 1).checked_mul(unit)?))
}

fn sample(kind: &str, bits: u32) -> Option<Sample> {
    let kind = kind.to_ascii_uppercase();
    let big_endian = !["LSB", "PC", "VAX"].iter().any(|little| kind.starts_with(little));
    let number = match kind.as_str() {
        "VAX_REAL" => return None, // not IEEE 754
        _ if kind.contains("REAL") || kind == "FLOAT" => SampleKind::Float,
        _ if kind.contains("UNSIGNED") => SampleKind::Unsigned,
        _ if kind.contains("INTEGER") => SampleKind::Signed,
        _ => return None,
    };
    let whole = number != SampleKind::Float && matches!(bits, 8 | 16 | 32 | 64);
    let float = number == SampleKind::Float && matches!(bits, 32 | 64);
    (whole || float).then_some(Sample {
        kind: number,
        bytes: bits / 8,
        big_endian,
    })
}

/// Returns the array that a VICAR label describes by its system items.
fn vicar_array(odl: &Group) -> Option<Array> {
    let offset = u64::from(unsigned(odl, "LBLSIZE")?);
    let record = u64::from(unsigned(odl, "RECSIZE")?);
    let header = u64::from(unsigned(odl, "NLB").unwrap_or(0));
    let (kind, bytes) = match odl.text("FORMAT")? {
        "BYTE" => (SampleKind::Unsigned, 1),
        "HALF" | "WORD" => (SampleKind::Signed, 2),
        "FULL" | "LONG" => (SampleKind::Signed, 4),
        "REAL" => (SampleKind::Float, 4),
        "DOUB" => (SampleKind::Float, 8),
        _ => return None,
    };
    let big_endian = match kind {
        SampleKind::Float => match odl.text("REALFMT") {
            Some("IEEE") => true,
            Some("RIEEE") => false,
            _ => return None, // VAX, also where nothing is said
        },
        _ => odl.text("INTFMT") == Some("HIGH"),
    };
    let sample = Sample {
        kind,
        bytes,
        big_endian,
    };
    let data = odl.find(&["IMAGE_DATA"]);
    Some(Array {
        file: None,
        offset: offset.checked_add(header.checked_mul(record)?)?,
        shape: [unsigned(odl, "NB")?, unsigned(odl, "NL")?, unsigned(odl, "NS")?],
        order: match odl.text("ORG")? {
            "BSQ" => BandStorage::BandSequential,
            "BIL" => BandStorage::LineInterleaved,
            "BIP" => BandStorage::PixelInterleaved,
            _ => return None,
        },
        sample,
        prefix_bytes: unsigned(odl, "NBB").unwrap_or(0),
        suffix_bytes: 0,
        bits: data.and_then(|group| values::mask_bits(group.text("SAMPLE_BIT_MASK")?)),
        scaling: None,
        missing: data
            .map(|group| constants(group, &MISSING, sample))
            .unwrap_or_default(),
        saturated: data
            .map(|group| constants(group, &SATURATED, sample))
            .unwrap_or_default(),
        companded_by: companded_by(odl),
        quantity: quantity(odl),
        lines: LineDirection::default(),
        samples: SampleDirection::default(),
    })
}

#[cfg(test)]
mod tests;

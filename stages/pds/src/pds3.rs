//! PDS3, ODL and VICAR labels, attached or detached, read as [`Label`].

mod camera;
mod keys;
mod scaling;

use marf_scene::Sensor;

use crate::label::{Array, BandStorage, BayerPhase, FileFacts, Label, Sample, SampleKind};
use crate::odl::{Group, Value};
use crate::{sensor, values};
use keys::{text, top, unsigned};

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
        sensor: sensor(odl),
        array: array(odl).or_else(|| vicar_array(odl)),
        file: whole_file(odl),
        phase: phase(odl),
        ..Label::default()
    };
    if let Some(array) = &mut label.array {
        scaling::apply(odl, array, &mut label.notes);
        set_directions(odl, array, &mut label.notes);
    }
    label.size = label.array.as_ref().map(|array| (array.shape[2], array.shape[1]));
    let method = state.and_then(|state| text(state, "BAYER_METHOD"));
    label.interpolated = method.as_deref().is_some_and(|method| method != "RAW_BAYER");
    label.mosaic = mosaic(odl);
    label.derived = camera::derived(odl);
    camera::add(odl, &mut label);
    label.drop_camera_of_turned_pixels();
    label
}

/// Sets the directions in which the image is displayed. One that lies on its side stays as it is stored, with a note.
fn set_directions(odl: &Group, array: &mut Array, notes: &mut Vec<String>) {
    let names = ["IMAGE", "IMAGE_DATA"];
    let image = described(odl).find(&names).or_else(|| odl.find(&names));
    let is = |key: &str, words: &[&str]| {
        let direction = image.and_then(|image| text(image, key));
        direction.is_some_and(|direction| words.iter().any(|word| direction.eq_ignore_ascii_case(word)))
    };
    let [lines, samples] = ["LINE_DISPLAY_DIRECTION", "SAMPLE_DISPLAY_DIRECTION"];
    if is(lines, &["LEFT", "RIGHT"]) || is(samples, &["UP", "DOWN"]) {
        notes.push("pixels are as stored: by its label, their lines are displayed as columns".to_owned());
        return;
    }
    if is(lines, &["UP"]) {
        array.upside_down = true;
    }
    if is(samples, &["LEFT"]) {
        array.mirrored = true;
    }
}

/// Returns the reason if a label is not of a photo, or its pixels are not read.
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
        .or_else(|| unread(odl))
}

/// Returns the reason if a VICAR label describes pixels in a form that is not read.
pub fn unread(odl: &Group) -> Option<String> {
    odl.get("LBLSIZE")?;
    if let Some(method) = text(odl, "COMPRESS") {
        return Some(format!(
            "its pixels are compressed, by `COMPRESS={method}` of its VICAR label: marf reads uncompressed ones"
        ));
    }
    let prefix_bytes = unsigned(odl, "NBB").filter(|bytes| *bytes > 0 && odl.text("ORG") == Some("BIP"))?;
    Some(format!(
        "each of its pixels has a prefix of {prefix_bytes} bytes, by `NBB` of its VICAR label: marf reads pixels without one"
    ))
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
    phase(odl)
}

/// Returns where on the detector the image starts.
fn phase(odl: &Group) -> Option<BayerPhase> {
    let image = odl.find(&["IMAGE", "IMAGE_DATA"])?;
    let first = |key| unsigned(image, key).unwrap_or(1).max(1) - 1;
    Some(BayerPhase {
        line: first("FIRST_LINE"),
        sample: first("FIRST_LINE_SAMPLE"),
    })
}

/// Returns whether the camera sees colour: by its colour filter array, else by its name.
fn sensor(odl: &Group) -> Option<Sensor> {
    let array = odl
        .find(&["INSTRUMENT_STATE_PARMS"])
        .and_then(|state| state.text("CFA_TYPE"));
    match array {
        Some("NONE") => Some(Sensor::Monochrome),
        Some(array) if array.starts_with("BAYER") => Some(Sensor::Color),
        _ => sensor::of_instrument(
            top(odl, "INSTRUMENT_HOST_ID").unwrap_or_default(),
            top(odl, "INSTRUMENT_ID").unwrap_or_default(),
        ),
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
        missing: constants(image, &MISSING, stored),
        saturated: constants(image, &SATURATED, stored),
        companded_by: companded_by(odl),
        ..Array::default()
    })
}

/// Returns the group that points to the image: the label itself, or an `OBJECT = FILE` (or `UNCOMPRESSED_FILE`) in it.
fn described(odl: &Group) -> &Group {
    let points = |group: &&Group| group.get("^IMAGE").is_some();
    let mut files = odl.descendants();
    files.retain(|group| ["FILE", "UNCOMPRESSED_FILE"].contains(&group.name.as_str()));
    std::iter::once(odl).chain(files).find(points).unwrap_or(odl)
}

/// Returns the size of the file that holds the image, where all its records are equally long.
fn whole_file(odl: &Group) -> FileFacts {
    let file = described(odl);
    let of_records = text(file, "RECORD_TYPE").is_some_and(|kind| kind == "FIXED_LENGTH");
    let records = || {
        let [record, records] = ["RECORD_BYTES", "FILE_RECORDS"].map(|key| unsigned(file, key));
        u64::from(record?).checked_mul(u64::from(records?))
    };
    FileFacts {
        bytes: of_records.then(records).flatten(),
        md5: None,
    }
}

fn constants(image: &Group, names: &[&str], sample: Sample) -> Vec<f64> {
    let given = names.iter().filter_map(|name| image.get(name));
    let constant = |value: &Value| values::constant(value.text()?, sample);
    given.flat_map(Value::items).filter_map(constant).collect()
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
    if unread(odl).is_some() {
        return None;
    }
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
        bits: data.and_then(|group| values::mask_bits(group.text("SAMPLE_BIT_MASK")?)),
        missing: data
            .map(|group| constants(group, &MISSING, sample))
            .unwrap_or_default(),
        saturated: data
            .map(|group| constants(group, &SATURATED, sample))
            .unwrap_or_default(),
        companded_by: companded_by(odl),
        ..Array::default()
    })
}

#[cfg(test)]
mod tests;

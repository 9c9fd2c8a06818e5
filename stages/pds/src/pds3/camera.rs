//! The camera of a label, and where the rover stood.

use marf_scene::{Cahvor, EntrancePupil, RoverPlace};

use super::keys::{identification, text};
use crate::camera::{self, CameraError};
use crate::label::{Derived, FramePose, Label, ordered_counter, same_place};
use crate::odl::{Group, Value};
use crate::values;

/// Adds camera and place. The place does not need the camera: without one it is that of the rover's frame.
pub(super) fn add(odl: &Group, label: &mut Label) {
    let names = ["GEOMETRIC_CAMERA_MODEL", "GEOMETRIC_CAMERA_MODEL_PARMS"];
    let group = odl.find(&names);
    let named = group.and_then(|group| text(group, "REFERENCE_COORD_SYSTEM_NAME"));
    let frame = named.clone().or_else(|| rover_frame(odl));
    let counter = ordered_counter(&motion_counter(odl));
    if let Some(frame) = frame.filter(|_| named.is_some() || !counter.is_empty()) {
        let pose = frame_pose(odl, group, &frame, &mut label.notes);
        label.set_place(frame, pose, counter);
    }
    match (group.map(model), named) {
        (None, _) => label.notes.push("label has no camera".to_owned()),
        (Some(Err(error)), _) => label.refuse_camera(&error),
        (Some(Ok(_)), None) => label
            .notes
            .push("label has no usable camera: its frame is not named".to_owned()),
        (Some(Ok(model)), Some(_)) => label.set_camera(&model),
    }
}

/// Returns what the values are. Without an index of its own, their frame is the one at the photo's counters.
pub(super) fn derived(odl: &Group) -> Derived {
    let Some(group) = odl.find(&["DERIVED_IMAGE_PARMS"]) else {
        return Derived::default();
    };
    let place = text(group, "REFERENCE_COORD_SYSTEM_NAME").map(|frame| {
        let own = counters(group.get("REFERENCE_COORD_SYSTEM_INDEX"), None);
        let counter = if own.is_empty() { motion_counter(odl) } else { own };
        let mut notes = Vec::new(); // those of the camera's frame say the same
        let pose = frame_pose(odl, Some(group), &frame, &mut notes);
        RoverPlace {
            frame,
            site_from_frame: pose.resolve(&mut notes),
            motion_counter: ordered_counter(&counter),
        }
    });
    Derived {
        kind: text(group, "DERIVED_IMAGE_TYPE"),
        place,
        origin: group.get("RANGE_ORIGIN_VECTOR").and_then(Value::numbers::<3>),
    }
}

/// Returns the name of the rover's frame that the label places in a site.
fn rover_frame(odl: &Group) -> Option<String> {
    let below = odl.descendants();
    let mut names = below
        .iter()
        .filter(|group| group.text("REFERENCE_COORD_SYSTEM_NAME") == Some("SITE_FRAME"))
        .filter_map(|group| text(group, "COORDINATE_SYSTEM_NAME"));
    names.find(|name| name.starts_with("ROVER"))
}

fn model(group: &Group) -> Result<Cahvor, CameraError> {
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
    let cahv = Cahvor {
        c: vector(0, "C")?,
        a: vector(1, "A")?,
        h: vector(2, "H")?,
        v: vector(3, "V")?,
        o: None,
        r: None,
        e: None,
    };
    let distorted = || {
        Ok(Cahvor {
            o: Some(vector(4, "O")?),
            r: Some(vector(5, "R")?),
            ..cahv
        })
    };
    match kind.as_str() {
        "CAHV" => Ok(cahv),
        "CAHVOR" => distorted(),
        "CAHVORE" => Ok(Cahvor {
            e: Some(entrance(group, vector(6, "E")?)?),
            ..distorted()?
        }),
        _ => Err(CameraError::Number("a model type of CAHV, CAHVOR or CAHVORE")),
    }
}

/// Returns the entrance pupil of a CAHVORE (components 7 to 9).
fn entrance(group: &Group, terms: [f64; 3]) -> Result<EntrancePupil, CameraError> {
    let kind = group.text("MODEL_COMPONENT_8").and_then(values::integer);
    let kind = kind.ok_or(CameraError::Number("the type of the CAHVORE"))?;
    let parameter = group.text("MODEL_COMPONENT_9").and_then(values::number);
    let parameter = parameter.or((kind != 3).then_some(0.0));
    let parameter = parameter.ok_or(CameraError::Number("the parameter of the CAHVORE"))?;
    camera::entrance(terms, kind, parameter)
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
fn frame_pose(odl: &Group, camera: Option<&Group>, frame: &str, notes: &mut Vec<String>) -> FramePose {
    if frame == "SITE_FRAME" {
        return FramePose::IsSite;
    }
    let is = |group: &Group, key: &str, word: &str| group.text(key) == Some(word);
    let of_camera = |key| camera.and_then(|camera| camera.get(key));
    let names = of_camera("COORDINATE_SYSTEM_INDEX_NAME");
    let wanted = match counters(of_camera("REFERENCE_COORD_SYSTEM_INDEX"), names) {
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

//! Records of the raw-image feeds of Mars 2020 (nested JSON) and MSL (flat), one record per file.

use marf_scene::Cahvor;
use serde_json::Value;

use crate::camera::{CameraError, entrance};
use crate::label::{BayerPhase, FramePose, Label, MAX_LABEL_BYTES};
use crate::{sensor, values};

/// Bytes that are not a record of a raw-image feed.
#[derive(Debug, thiserror::Error)]
pub enum FeedError {
    /// Larger than any record.
    #[error("{0} bytes of JSON, at most {MAX_LABEL_BYTES} are read")]
    TooLarge(usize),
    /// Not JSON.
    #[error("no JSON: {0}")]
    Malformed(#[from] serde_json::Error),
    /// A page or another JSON.
    #[error("JSON without `imageid`: no record of a raw-image feed")]
    NoRecord,
    /// A page of many records.
    #[error("a page of {0} feed records: one record a file is read, named like its photo")]
    Page(usize),
}

/// Reads one record as a label.
///
/// # Errors
/// See [`FeedError`]. A record without a usable camera is not an error but a note.
pub fn read(bytes: &[u8]) -> Result<Label, FeedError> {
    if bytes.len() > MAX_LABEL_BYTES {
        return Err(FeedError::TooLarge(bytes.len()));
    }
    let json: Value = serde_json::from_slice(bytes)?;
    if let Some(page) = ["images", "items"]
        .iter()
        .find_map(|key| json.get(*key)?.as_array())
    {
        return Err(FeedError::Page(page.len()));
    }
    let record = Record(&json);
    let product = record.text("imageid").ok_or(FeedError::NoRecord)?;
    let mut label = Label {
        product: Some(product),
        sol: record.text("sol").and_then(|sol| values::sol(&sol)),
        instrument: record.text("instrument"),
        filter: record.text("filter_name"),
        thumbnail: is_thumbnail(&json),
        averaged: 1,
        sensor: sensor::of_instrument(&record.host(), &record.text("instrument").unwrap_or_default()),
        size: record.size(),
        phase: record.phase(),
        ..Label::default()
    };
    add_camera(&record, &mut label);
    Ok(label)
}

/// Returns a known value of a record as text: one at the top, or under `camera` or `extended`.
pub fn field(record: &Value, key: &str) -> Option<String> {
    let places = [Some(record), record.get("camera"), record.get("extended")];
    places
        .into_iter()
        .flatten()
        .find_map(|place| text(place.get(key)?))
}

/// Returns a known value as text.
pub fn text(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => values::known(text),
        Value::Number(number) => Some(number.to_string()),
        Value::Bool(truth) => Some(truth.to_string()),
        _ => None,
    }
}

/// Whether a record calls its photo a thumbnail.
pub fn is_thumbnail(record: &Value) -> bool {
    let is = |key, word: &str| field(record, key).is_some_and(|text| text.eq_ignore_ascii_case(word));
    is("sample_type", "thumbnail") || is("is_thumbnail", "true")
}

struct Record<'a>(&'a Value);

impl Record<'_> {
    fn text(&self, key: &str) -> Option<String> {
        field(self.0, key)
    }

    /// Records of Mars 2020 are nested, those of MSL are flat.
    fn host(&self) -> String {
        let host = self.0.get("camera").map_or("MSL", |_| "M20");
        host.to_owned()
    }

    fn size(&self) -> Option<(u32, u32)> {
        let [width, height] = values::tuple::<2>(&self.text("dimension")?)?;
        let side =
            |value: f64| ((1.0..=65_536.0).contains(&value) && value.fract() == 0.0).then_some(value as u32);
        Some((side(width)?, side(height)?))
    }

    /// `(x0,y0,w,h)`, from 1.
    fn phase(&self) -> Option<BayerPhase> {
        let [sample, line, _, _] =
            values::tuple::<4>(&self.text("subframeRect").or_else(|| self.text("subframe_rect"))?)?;
        let first = |value: f64| (1.0..=65_536.0).contains(&value).then(|| value as u32 - 1);
        Some(BayerPhase {
            line: first(line)?,
            sample: first(sample)?,
        })
    }

    fn pose(&self) -> FramePose {
        let quaternion = self.text("attitude").and_then(|text| values::tuple(&text));
        let offset = self.text("xyz").and_then(|text| values::tuple(&text));
        match (quaternion, offset) {
            (Some(quaternion), Some(offset)) => FramePose::Given { quaternion, offset },
            _ => FramePose::Unknown,
        }
    }

    /// Site and drive. Feeds have no further counters.
    fn counter(&self) -> Vec<i64> {
        let number = |key| self.text(key).and_then(|text| values::integer(&text));
        match (number("site"), number("drive")) {
            (Some(site), Some(drive)) => vec![site, drive],
            _ => Vec::new(),
        }
    }
}

fn add_camera(record: &Record<'_>, label: &mut Label) {
    let frame = frame(label);
    label.set_place(frame, record.pose(), record.counter());
    let Some(components) = record.text("camera_model_component_list") else {
        label.notes.push("label has no camera".to_owned());
        return;
    };
    match model(&components) {
        Ok(model) => label.set_camera(&model),
        Err(error) => label.refuse_camera(&error),
    }
}

/// Feeds name no frame. For rovers the numbers are in ROVER_NAV: C is at the mast head, 2 m up.
fn frame(label: &mut Label) -> String {
    if !label
        .instrument
        .as_deref()
        .is_some_and(|name| name.starts_with("HELI"))
    {
        return "ROVER_NAV_FRAME".to_owned();
    }
    label
        .notes
        .push("the helicopter's pose is its navigation's estimate, in a frame of the flight".to_owned());
    "HELI_FRAME".to_owned()
}

/// Reads `(C);(A);(H);(V)`, `…;(O);(R)`, `…;(E)` with `type;parameter`.
fn model(components: &str) -> Result<Cahvor, CameraError> {
    let parts: Vec<&str> = components.split(';').map(str::trim).take(10).collect();
    let vector = |index: usize, name: &'static str| {
        let tuple = parts.get(index).and_then(|part| values::tuple::<3>(part));
        tuple.ok_or(CameraError::Number(name))
    };
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
    match parts.len() {
        4 => Ok(cahv),
        6 => distorted(),
        9 => {
            let kind = values::integer(parts[7]).ok_or(CameraError::Number("the type of the CAHVORE"))?;
            let parameter =
                values::number(parts[8]).ok_or(CameraError::Number("the parameter of the CAHVORE"))?;
            Ok(Cahvor {
                e: Some(entrance(vector(6, "E")?, kind, parameter)?),
                ..distorted()?
            })
        }
        _ => Err(CameraError::Number("a model of 4, 6 or 9 components")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIX: &str = "(0.8,0.56,-1.92);(1,0,0);(823.5,14800,0);(599.5,0,14800);(1,0,0);(0.0002,0.39,0.035)";

    fn with(components: &str) -> Label {
        let record = serde_json::json!({
            "imageid": "NLF_0050", "sol": 50, "site": 3, "drive": "1950", "sample_type": "Full",
            "attitude": "(0.8,0.0,0.0,0.6)",
            "camera": {"instrument": "NAVCAM_LEFT", "filter_name": "UNK", "camera_model_component_list": components},
            "extended": {"xyz": "(12.5,-3.25,0.125)", "dimension": "(1280,240)"},
        });
        read(record.to_string().as_bytes()).unwrap()
    }

    #[test]
    fn a_record_becomes_a_label() {
        let label = with(SIX);
        assert_eq!(
            (label.sol, label.size, label.thumbnail),
            (Some(50), Some((1280, 240)), false)
        );
        assert_eq!(
            (label.instrument.as_deref(), label.filter.as_deref()),
            (Some("NAVCAM_LEFT"), None)
        );
        let prior = label.prior.unwrap();
        assert_eq!(prior.motion_counter, [3, 1950]);
        assert_eq!(prior.model.h, [823.5, 14_800.0, 0.0]);
        assert_eq!(prior.site_from_frame.unwrap().translation.x, 12.5);
        assert!(label.notes.is_empty(), "{:?}", label.notes);
    }

    #[test]
    fn components_of_four_six_and_nine_are_read() {
        let four = SIX.split(';').take(4).collect::<Vec<_>>().join(";");
        assert!(with(&four).prior.unwrap().model.o.is_none());
        let e = with(&format!("{SIX};(-0.0036,0.013,-0.024);2.0;0.0"))
            .prior
            .unwrap()
            .model
            .e
            .unwrap();
        assert_eq!((e.terms, e.linearity), ([-0.0036, 0.013, -0.024], 0.0));
    }

    #[test]
    fn a_record_without_a_usable_camera_stays_with_a_note() {
        for bad in [
            "UNK",
            "",
            "(1,2,3)",
            &SIX.replace("(1,0,0)", "(UNK,0,0)"),
            &format!("{SIX};(0,0,0);2;0;7"),
        ] {
            let label = with(bad);
            assert!(label.prior.is_none(), "{bad}");
            assert!(
                label.notes[0].contains("label has no"),
                "{bad}: {:?}",
                label.notes
            );
        }
        let unknown = with(&SIX.replacen("(1,0,0)", "(UNK,0,0)", 1));
        assert!(
            unknown.notes[0].ends_with("A is missing or no finite number"),
            "{:?}",
            unknown.notes
        );
    }

    #[test]
    fn other_json_is_refused() {
        let deep = "[".repeat(100_000);
        for bad in [
            "{}",
            "[]",
            "null",
            "",
            "{\"imageid\": 1e999}",
            &deep,
            "{\"images\": [{}, {}]}",
            "{\"imageid\":\"UNK\"}",
        ] {
            assert!(read(bad.as_bytes()).is_err(), "{:.20}", bad);
        }
    }

    #[test]
    fn a_flat_record_of_msl_is_read() {
        let record = serde_json::json!({
            "imageid": "NLB_586004185EDR_F0721234NCAM00295M_", "sol": 2, "is_thumbnail": true, "instrument": "NAV_LEFT_B",
            "camera_model_component_list": SIX, "attitude": null, "extended": {"filter_name": null},
        });
        let label = read(record.to_string().as_bytes()).unwrap();
        assert!(label.thumbnail && label.prior.is_some_and(|prior| prior.site_from_frame.is_none()));
        assert!(label.notes[0].contains("does not place"), "{:?}", label.notes);
    }
}

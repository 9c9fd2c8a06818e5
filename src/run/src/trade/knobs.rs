//! What can be turned, and how far.

use marf_cache::digest_of;
use marf_field::Device;
use marf_report::trade::Point;
use marf_schema::calibrate::{CalibrateParams, Method};
use marf_schema::train::{Fit, Metrics};
use serde_json::{Value, json};

use super::base::Base;
use crate::error::{Diagnostic, Error};
use crate::session::Session;

/// A key of the pipeline with other values for it.
#[derive(Debug, Clone, PartialEq)]
pub struct Knob {
    /// As the command line names it (`train.scale`).
    pub key: String,
    /// Values in addition to the pipeline's own.
    pub values: Vec<Value>,
}

impl Knob {
    /// Returns the setting of a value as the command line takes it.
    pub fn set(&self, value: &Value) -> String {
        format!("{}={}", self.key, toml_text(value))
    }
}

/// Returns the knobs of `[trade]`, or else knobs around the values of the pipeline. If `wanted` is not empty, returns only those.
///
/// # Errors
/// A wanted knob that does not exist.
pub fn knobs(session: &Session, base: &Base, wanted: &[String]) -> Result<Vec<Knob>, Error> {
    let knobs = match session.tree.get("trade").and_then(Value::as_object) {
        Some(table) => table
            .iter()
            .map(|(key, values)| Knob {
                key: key.clone(),
                values: values.as_array().cloned().unwrap_or_default(),
            })
            .collect(),
        None => around(session, base)?,
    };
    if let Some(unknown) = wanted
        .iter()
        .find(|key| !knobs.iter().any(|knob| knob.key == **key))
    {
        let known: Vec<&str> = knobs.iter().map(|knob| knob.key.as_str()).collect();
        let hint = format!(
            "the knobs are {}. `[trade]` in pipeline.toml adds others",
            known.join(", ")
        );
        return Err(Error::Usage(
            Diagnostic::new(format!("--knob {unknown}: no such knob")).hint(hint),
        ));
    }
    let is_wanted = |knob: &Knob| wanted.is_empty() || wanted.contains(&knob.key);
    Ok(knobs.into_iter().filter(is_wanted).collect())
}

/// Returns points with every knob at a random one of its values or at the pipeline's, at least two turned. They are the same each time.
/// There are fewer, or none, if there is little to turn.
pub fn random(knobs: &[Knob], count: u64) -> Vec<Point> {
    let point = |index: u64| {
        let set = |knob: &Knob| {
            let digest = digest_of(&(("trade", index), knob.key.as_str()));
            let draw = digest.as_bytes()[0] as usize % (knob.values.len() + 1);
            knob.values.get(draw).map(|value| knob.set(value))
        };
        Point {
            sets: knobs.iter().filter_map(set).collect(),
            ..Point::default()
        }
    };
    let points = (0..100 * count).map(point).filter(|point| point.sets.len() > 1);
    points.take(count as usize).collect()
}

/// Returns knobs around the values that the pipeline has.
fn around(session: &Session, base: &Base) -> Result<Vec<Knob>, Error> {
    let metrics = base.metrics()?;
    let mut knobs = of_training(&base.train, &metrics);
    if let Some(name) = &base.calibrate {
        let info = session.nodes.iter().find(|info| info.name == *name);
        let params = info.map(|info| info.params.clone()).unwrap_or_default();
        if let Ok(params) = serde_json::from_value::<CalibrateParams>(params) {
            knobs.extend(of_calibration(name, &params));
        }
    }
    Ok(knobs)
}

fn of_training(node: &str, metrics: &Metrics) -> Vec<Knob> {
    let Metrics {
        steps,
        fit,
        config,
        field,
        scale,
        train_photos,
        gpu,
        ..
    } = metrics;
    let levels = field.levels.len() as u64;
    let other_width = if config.color_width > 32 { 32 } else { 64 };
    let other_view = match serde_json::to_value(config.view_dependence) {
        Ok(Value::String(word)) if word == "off" => "on",
        _ => "off",
    };
    let other_fit = match fit {
        Fit::Scene => "fixed",
        Fit::Fixed => "scene",
    };
    let scales = match scale {
        1 => vec![json!(2)],
        scale => vec![json!(scale / 2), json!(scale * 2)],
    };
    let other_device = match gpu {
        Some(_) => Some("cpu"),
        None => marf_field_gpu::backend_id(&Device::Auto).map(|_| "gpu"),
    };
    let half_and_twice = |value: u32| vec![json!(value / 2), json!(value * 2)];
    let knob = |key: &str, values: Vec<Value>| Knob {
        key: format!("{node}.{key}"),
        values,
    };
    let knobs = [
        knob(
            "steps",
            vec![
                json!(steps / 4),
                json!(steps / 2),
                json!(steps * 2),
                json!(steps * 4),
            ],
        ),
        knob("scale", scales),
        knob("photos", vec![json!((train_photos / 2).max(1))]),
        knob("field.batch_samples", half_and_twice(config.batch_samples)),
        knob("field.ray_samples", vec![json!(32), json!(96)]),
        knob("field.levels", vec![json!(levels / 2), json!(levels * 3 / 4)]),
        knob("field.log2_table_shift", vec![json!(-2), json!(-1), json!(1)]),
        knob("field.finest_factor", vec![json!(0.5), json!(2.0)]),
        knob("field.color_width", vec![json!(other_width)]),
        knob("field.view_dependence", vec![json!(other_view)]),
        knob(
            "field.cone",
            vec![json!(config.cone / 2.0), json!(config.cone * 2.0)],
        ),
        knob(
            "field.occupancy_resolution",
            half_and_twice(config.occupancy_resolution),
        ),
        knob("fit", vec![json!(other_fit)]),
    ];
    let device = other_device.map(|device| knob("device", vec![json!(device)]));
    knobs.into_iter().chain(device).collect()
}

/// Structure from motion alone takes time.
fn of_calibration(node: &str, params: &CalibrateParams) -> Vec<Knob> {
    if params.method != Method::Sfm {
        return Vec::new();
    }
    let knob = |key: &str, values: Vec<Value>| Knob {
        key: format!("{node}.{key}"),
        values,
    };
    let (features, side) = (params.max_features, params.feature_side_px);
    vec![
        knob("max_features", vec![json!(features / 2), json!(features * 2)]),
        knob("feature_side_px", vec![json!(side / 2), json!(side * 3 / 2)]),
        knob("pairs", vec![json!("sequential")]),
        knob("lens", vec![json!("pinhole"), json!("opencv")]),
    ]
}

/// Returns a value as the command line takes it after `=`.
fn toml_text(value: &Value) -> String {
    match toml::Value::try_from(value) {
        Ok(value) => value.to_string(),
        // JSON's `null` alone, which no list of values holds.
        Err(_) => String::new(),
    }
}

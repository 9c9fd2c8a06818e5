//! The height map of `depth` next to the true ground.

use std::{collections::HashMap, fs, path::Path};

use marf_numeric::upper_median;
use marf_schema::surface::MapReport;
use nalgebra::Vector3;
use serde_json::{Value, json};

use super::truth::KnownScene;
use crate::output::Result;

/// Ground counts up to this distance from a photo, metres.
const REACH_M: f64 = 10.0;

/// Returns the share of the cells within reach of a photo that shows them which have a height, and the median error. The true height
/// of a cell is the mean of what all pixels of all photos show there.
pub fn heights(known: &KnownScene, map: &MapReport, dir: &Path) -> Result<Value> {
    let picture = image::load_from_memory(&fs::read(dir.join("map/height.png"))?)?.into_luma16();
    let [right, top, up] = map.axes.map(Vector3::from);
    let mut truth: HashMap<[i64; 2], (f64, u32)> = HashMap::new();
    for photo in &known.photos {
        for (column, row) in
            (0..photo.ranges.height).flat_map(|row| (0..photo.ranges.width).map(move |at| (at, row)))
        {
            let Some(place) = photo.point(column, row, REACH_M) else {
                continue;
            };
            let at = [
                ((place.dot(&right) - map.first_m[0]) / map.pixel_m).round() as i64,
                ((map.first_m[1] - place.dot(&top)) / map.pixel_m).round() as i64,
            ];
            let (sum, count) = truth.entry(at).or_default();
            *sum += place.dot(&up);
            *count += 1;
        }
    }
    let errors = truth.iter().filter_map(|([column, row], (sum, count))| {
        let (column, row) = (u32::try_from(*column).ok()?, u32::try_from(*row).ok()?);
        let steps = picture.get_pixel_checked(column, row)?.0[0].checked_sub(1)?;
        let height_m = map.lowest_m + f64::from(steps) * map.interval_m;
        Some((height_m - sum / f64::from(*count)).abs())
    });
    let errors: Vec<f64> = errors.collect();
    Ok(json!({
        "cells": truth.len(),
        "with_height_share": errors.len() as f64 / truth.len().max(1) as f64,
        "median_error_m": upper_median(errors),
    }))
}

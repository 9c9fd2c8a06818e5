//! `true-depth`: the depths of a bootstrap, and their 90 % intervals, next to the truth.

use std::{fs, path::Path};

use marf_numeric::upper_median;
use nalgebra::Vector2;
use serde_json::json;

use super::maps::array;
use super::truth::{Known, KnownScene};
use crate::output::{Result, print_json};

/// Prints errors and coverage for each photo that has a map.
pub fn depth(scene: &Path, maps: &Path) -> Result {
    let known = KnownScene::read(scene)?;
    let mut covers = Vec::new();
    for (frame, truth) in known.scene.frames.iter().zip(&known.photos) {
        let name = frame.file.strip_suffix(".png").unwrap_or(&frame.file);
        if fs::exists(maps.join(format!("{name}-depth-interval.npy")))? {
            covers.push(coverage(truth, maps, name)?);
        }
    }
    let mean = covers.iter().sum::<f64>() / covers.len().max(1) as f64;
    print_json(&json!({"photos": covers.len(), "mean_coverage90": mean}))
}

/// Prints the errors of the map of a photo and returns the share of its pixels whose interval holds the truth.
fn coverage(truth: &Known, maps: &Path, name: &str) -> Result<f64> {
    let depth = array(&maps.join(format!("{name}-depth.npy")))?;
    let interval = array(&maps.join(format!("{name}-depth-interval.npy")))?;
    let pinhole = truth.pinhole_of_width(depth.columns)?;
    let centre = truth.photo.cam_from_site.centre();
    let (mut errors, mut inside) = (Vec::new(), 0);
    for (index, (depth_m, half_m)) in depth.values.iter().zip(&interval.values).enumerate() {
        let (column, row) = (index as u32 % depth.columns, index as u32 / depth.columns);
        let pixel = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let place = truth.point_of_pinhole(&pinhole, &pixel, f64::INFINITY);
        if let Some(place) = place.filter(|_| *half_m >= 0.0) {
            let range_m = (place - centre).norm();
            let error = (f64::from(*depth_m) - range_m).abs();
            errors.push(error / range_m);
            inside += u32::from(error <= f64::from(*half_m));
        }
    }
    let pixels = errors.len();
    let cover = f64::from(inside) / pixels.max(1) as f64;
    let median = upper_median(errors);
    print_json(&json!({"photo": name, "pixels": pixels, "median_error_share": median, "coverage90": cover}))?;
    Ok(cover)
}

//! `true-depth`: the depths of a bootstrap, and their 90 % intervals, next to the truth.
//!
//! `calibrate` resamples photos to ideal pinholes, so a pixel of a map is looked up in the true photo by its ray.

use std::{fs, path::Path};

use marf_demo::{Demo, DemoOptions};
use marf_scene::Camera;
use nalgebra::Vector2;
use serde_json::json;

use super::maps::array;
use super::truth::sol_of;
use crate::output::{Result, print_json};

/// Prints errors and coverage for each photo that has a map.
pub fn depth(scene: &Path, maps: &Path) -> Result {
    let scene: serde_json::Value = serde_json::from_slice(&fs::read(scene)?)?;
    let demo = Demo::new(DemoOptions::default())?;
    let mut names = Vec::new();
    for entry in fs::read_dir(maps)? {
        let name = entry?.file_name().to_string_lossy().into_owned();
        names.extend(name.strip_suffix("-depth-interval.npy").map(str::to_owned));
    }
    names.sort();
    let mut covers = Vec::new();
    for name in &names {
        // Names of photos begin with instrument, eye and sol. Photos along a path have other names, and no truth
        // here.
        let Some(sol) = sol_of(name) else { continue };
        let file = format!("{name}.png");
        let frames = scene["frames"].as_array().into_iter().flatten();
        let frame = frames.into_iter().find(|frame| frame["file"] == file.as_str());
        let frame = frame.ok_or_else(|| format!("{file} is not in the scene"))?;
        let camera = serde_json::from_value(frame["camera"].clone())?;
        covers.push(coverage(&demo, sol, maps, name, camera)?);
    }
    let mean = covers.iter().sum::<f64>() / covers.len().max(1) as f64;
    print_json(&json!({"photos": covers.len(), "mean_coverage90": mean}))
}

/// Prints the errors of the map of a photo and returns the share of its pixels whose interval holds the truth.
fn coverage(demo: &Demo, sol: u32, maps: &Path, name: &str, camera: Camera) -> Result<f64> {
    let depth = array(&maps.join(format!("{name}-depth.npy")))?;
    let interval = array(&maps.join(format!("{name}-depth-interval.npy")))?;
    let file = format!("{name}.png");
    let truth = demo.ranges(sol, &file)?;
    let photos = demo.ground_truth(sol)?.photos;
    let photo = photos
        .iter()
        .find(|photo| photo.file == file)
        .ok_or("no true photo")?;
    let camera = camera.box_reduced(camera.width / depth.columns);
    let range_m = |column: u32, row: u32| -> Option<f32> {
        let ray = camera.unproject(&Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5))?;
        let pixel = photo.pinhole.project(&ray)?;
        let inside = pixel.x >= 0.0
            && pixel.y >= 0.0
            && pixel.x < f64::from(truth.width)
            && pixel.y < f64::from(truth.height);
        inside.then(|| truth.range_m[pixel.y as usize * truth.width as usize + pixel.x as usize])
    };
    let (mut errors, mut inside) = (Vec::new(), 0);
    for (index, (depth_m, half_m)) in depth.values.iter().zip(&interval.values).enumerate() {
        let Some(range_m) = range_m(index as u32 % depth.columns, index as u32 / depth.columns) else {
            continue;
        };
        if *half_m >= 0.0 && range_m.is_finite() {
            let error = (depth_m - range_m).abs();
            errors.push(error / range_m);
            inside += u32::from(error <= *half_m);
        }
    }
    errors.sort_by(f32::total_cmp);
    let pixels = errors.len();
    let cover = f64::from(inside) / pixels.max(1) as f64;
    let median = errors.get(pixels / 2).copied().unwrap_or_default();
    print_json(&json!({"photo": name, "pixels": pixels, "median_error_share": median, "coverage90": cover}))?;
    Ok(cover)
}

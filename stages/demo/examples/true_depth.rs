//! Compares the depths of a run of the built-in Mars, and their 90 % intervals, with the truth, a JSON line a photo and one of the means:
//! `cargo run --release -p marf-demo --example true_depth -- out/calibrate/scene.json out/bootstrap/maps`.
//!
//! `calibrate` resamples photos to ideal pinholes, so a pixel of a map is looked up in the true photo by its ray.

mod maps;

use std::{error::Error, fs, io::Write, path::Path};

use maps::array;
use marf_demo::{Demo, DemoOptions};
use marf_scene::Camera;
use nalgebra::Vector2;
use serde_json::json;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let scene = fs::read(arguments.next().ok_or("name a scene")?)?;
    let scene: serde_json::Value = serde_json::from_slice(&scene)?;
    let folder = arguments.next().ok_or("name the folder of maps of a bootstrap")?;
    let folder = Path::new(&folder);
    let demo = Demo::new(DemoOptions::default())?;
    let mut names = Vec::new();
    for entry in fs::read_dir(folder)? {
        let name = entry?
            .file_name()
            .into_string()
            .map_err(|name| format!("{name:?} is no text"))?;
        names.extend(name.strip_suffix("-depth-interval.npy").map(str::to_owned));
    }
    // Names of photos begin with instrument, eye and sol; those along a path do not, and have no truth here.
    names.retain(|name| sol_of(name).is_some());
    names.sort();
    let mut rows = Vec::new();
    let mut stdout = std::io::stdout().lock();
    for name in &names {
        let sol = sol_of(name).ok_or("no sol")?;
        let depth = array(&folder.join(format!("{name}-depth.npy")))?;
        let interval = array(&folder.join(format!("{name}-depth-interval.npy")))?;
        let file = format!("{name}.png");
        let truth = demo.ranges(sol, &file)?;
        let photos = demo.ground_truth(sol)?.photos;
        let photo = photos
            .iter()
            .find(|photo| photo.file == file)
            .ok_or("no true photo")?;
        let found = scene["frames"]
            .as_array()
            .and_then(|frames| frames.iter().find(|frame| frame["file"] == file.as_str()));
        let camera: Camera = serde_json::from_value(found.ok_or("not in the scene")?["camera"].clone())?;
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
            let (column, row) = (index as u32 % depth.columns, index as u32 / depth.columns);
            let Some(range_m) = range_m(column, row) else {
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
        writeln!(
            stdout,
            "{}",
            json!({"photo": name, "pixels": pixels, "median_error_share": median, "coverage90": cover})
        )?;
        rows.push(cover);
    }
    let mean = rows.iter().sum::<f64>() / rows.len().max(1) as f64;
    writeln!(
        stdout,
        "{}",
        json!({"photos": rows.len(), "mean_coverage90": mean})
    )?;
    Ok(())
}

/// Returns the sol of a product id such as `ZL0_0003_..`.
fn sol_of(name: &str) -> Option<u32> {
    name.get(4..8)?.parse().ok()
}

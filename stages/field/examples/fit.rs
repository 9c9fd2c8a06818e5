//! Trains on a folder with `transforms.json` (nerfstudio's convention) and scores the held-out views.
//! Sparse points are read from `points.json` beside it, if that is there.
//!
//! `fit DIR SECONDS[,SECONDS] OUT [key=value ...]`: keys are those of the field's config, values JSON, and `seed`.
//! With FIT_CLOCK=cpu the clock is processor time over two threads, for a machine that does other work, too.
//! Writes OUT/<seconds>s/<name>.png and prints one JSON line a budget. The clock runs in training steps only.
#![allow(clippy::print_stdout)]

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use marf_field::{Config, Field, Trainer, View};
use marf_scene::{Camera, Image, Photo, Pose, Srgb, encode_png};
use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, budgets, out, keys @ ..] = arguments.as_slice() else {
        return Err("usage: fit DIR SECONDS[,SECONDS] OUT [key=value ...]".into());
    };
    let (config, seed) = configured(keys)?;
    let (train, test) = load(Path::new(folder))?;
    let began = Instant::now();
    let mut trainer = Trainer::new(train, &points(Path::new(folder))?, &config, seed)?;
    println!(
        "{}",
        json!({"start_s": began.elapsed().as_secs_f64(), "facts": trainer.field().facts()})
    );
    let (mut clock, mut told, mut rays, mut samples) = (0.0, 0.0, 0, 0);
    for budget in budgets.split(',') {
        let seconds: f64 = budget.parse()?;
        let mut loss = 0.0;
        while clock < seconds {
            let start = now(&began);
            let step = trainer.step()?;
            clock += now(&began) - start;
            loss = 0.99 * loss + 0.01 * step.loss;
            rays += step.rays;
            samples += step.samples;
            if clock - told >= 1.0 && std::env::var("FIT_TRACE").is_ok() {
                told = clock;
                let (rays, samples) = (step.rays, step.samples);
                let occupied = trainer.field().facts().occupied_share;
                println!(
                    "{clock:.1} s, step {}: {rays} rays, {samples} samples, {occupied:.4} occupied, loss {loss:.5}",
                    trainer.steps()
                );
            }
        }
        let field = trainer.field();
        let start = Instant::now();
        let psnr = score(&field, &test, &Path::new(out).join(format!("{budget}s")))?;
        let line = json!({"budget": seconds, "psnr": psnr.iter().sum::<f64>() / psnr.len() as f64, "steps": trainer.steps(),
            "rays_per_s": rays as f64 / clock, "samples_per_s": samples as f64 / clock, "spr": samples as f64 / rays as f64, "loss": loss,
            "render_s": start.elapsed().as_secs_f64() / psnr.len() as f64, "occupied": field.facts().occupied_share,
            "mb": field.encode().len() >> 20, "each": psnr.iter().map(|psnr| (psnr * 10.0).round() / 10.0).collect::<Vec<_>>()});
        println!("{line}");
    }
    Ok(())
}

/// Wall clock, or half the processor time of this process (Linux counts it in 1/100 s).
fn now(began: &Instant) -> f64 {
    if std::env::var("FIT_CLOCK").is_ok_and(|clock| clock == "cpu") {
        let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
        let fields: Vec<&str> = stat.split(' ').collect();
        let ticks = |index: usize| fields.get(index).and_then(|ticks| ticks.parse::<f64>().ok());
        return (ticks(13).unwrap_or(0.0) + ticks(14).unwrap_or(0.0)) / 200.0;
    }
    began.elapsed().as_secs_f64()
}

fn configured(keys: &[String]) -> Result<(Config, u64)> {
    let (mut map, mut seed) = (serde_json::Map::new(), 0);
    for key in keys {
        let (key, value) = key.split_once('=').ok_or("expected key=value")?;
        let value: Value = serde_json::from_str(value).unwrap_or_else(|_| json!(value));
        if key == "seed" {
            seed = value.as_u64().ok_or("seed is an integer")?;
        } else {
            map.insert(key.to_owned(), value);
        }
    }
    Ok((serde_json::from_value(Value::Object(map))?, seed))
}

/// A view with its photo.
type Test = (View, Image<Srgb>);

fn load(folder: &Path) -> Result<(Vec<View>, Vec<Test>)> {
    let scene: Value = serde_json::from_slice(&std::fs::read(folder.join("transforms.json"))?)?;
    let held_out = scene["test_filenames"].as_array().ok_or("no test_filenames")?;
    let (mut train, mut test) = (Vec::new(), Vec::new());
    for frame in scene["frames"].as_array().ok_or("no frames")? {
        let name = frame["file_path"].as_str().ok_or("no file_path")?;
        let image = Photo::decode(&std::fs::read(folder.join(name))?)?.image;
        let view = View {
            id: name.to_owned(),
            camera: camera(&scene, &image)?,
            cam_from_world: pose(&frame["transform_matrix"])?,
            image: image.clone().into(),
        };
        if held_out.contains(&json!(name)) {
            test.push((view, image));
        } else {
            train.push(view);
        }
    }
    Ok((train, test))
}

/// Sparse points, `[[x, y, z], ..]` in `points.json`, if it is there.
fn points(folder: &Path) -> Result<Vec<[f64; 3]>> {
    match std::fs::read(folder.join("points.json")) {
        Ok(bytes) => Ok(serde_json::from_slice(&bytes)?),
        Err(_) => Ok(Vec::new()),
    }
}

fn camera(scene: &Value, image: &Image<Srgb>) -> Result<Camera> {
    let number = |key: &str| scene[key].as_f64().unwrap_or(0.0);
    Ok(Camera {
        fx_px: number("fl_x"),
        fy_px: number("fl_y"),
        cx_px: number("cx"),
        cy_px: number("cy"),
        k1: number("k1"),
        k2: number("k2"),
        p1: number("p1"),
        p2: number("p2"),
        ..Camera::pinhole(image.width, image.height, 1.0)
    })
}

/// From a camera with y up and z backwards.
fn pose(matrix: &Value) -> Result<Pose> {
    let rows: [[f64; 4]; 4] = serde_json::from_value(matrix.clone())?;
    let world_from_gl = Matrix3::from_fn(|row, column| rows[row][column]);
    let world_from_cam = Pose {
        rotation: world_from_gl * Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)),
        translation: Vector3::from_fn(|row, _| rows[row][3]),
    };
    Ok(world_from_cam.inverse())
}

fn score(field: &Field, views: &[Test], out: &Path) -> Result<Vec<f64>> {
    std::fs::create_dir_all(out)?;
    let limit = std::env::var("FIT_VIEWS")
        .ok()
        .and_then(|limit| limit.parse().ok())
        .unwrap_or(usize::MAX);
    let scores = views.iter().take(limit).map(|(view, photo)| {
        let image = field.render(&view.camera, &view.cam_from_world).to_image();
        let name = Path::new(&view.id).file_name().ok_or("no file name")?;
        std::fs::write(out.join(name), encode_png(&image)?)?;
        let pairs = image
            .pixels
            .as_flattened()
            .iter()
            .zip(photo.pixels.as_flattened());
        let sum: f64 = pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
        let mse = sum / (3 * image.pixels.len()) as f64 / (255.0 * 255.0);
        Ok(-10.0 * mse.max(1e-10).log10())
    });
    scores.collect()
}

//! Compares the held-out pictures of a training of the built-in Mars with what the true scene shows through the same cameras,
//! a JSON line a photo and one of the means: `cargo run --release -p marf-demo --example true_pictures -- out/train`.
//!
//! `field` is the PSNR of the field's picture against the photo. `truth` is that of the true scene, drawn through the camera as
//! calibration found it, after the similarity that carries the cameras of the scene to the true ones: what is missing there is the
//! cameras' error and the resampling of the photo, and no field can gain it.

mod truth;

use std::{error::Error, fs, io::Write, path::Path};

use marf_demo::{Demo, DemoOptions};
use marf_scene::{Image, Photo, Pose, Scene, Srgb, metrics::psnr};
use nalgebra::{Matrix3, Vector3};
use serde_json::json;
use truth::{alignment, true_photos};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("name the folder of a training")?;
    let folder = Path::new(&folder);
    let scene = Scene::decode(&fs::read(folder.join("scene.json"))?)?;
    let demo = Demo::new(DemoOptions::default())?;
    let known = true_photos(&demo, &scene)?;
    let site_from_scene = alignment(&scene, &known);
    let mut stdout = std::io::stdout().lock();
    let mut rows = Vec::new();
    for frame in scene.frames.iter().filter(|frame| frame.held_out) {
        let name = format!("{}.png", frame.id);
        let picture = |kind: &str| -> Result<Image<Srgb>, Box<dyn Error>> {
            Ok(Photo::decode(&fs::read(folder.join(kind).join(&name))?)?.image)
        };
        let photo = picture("photo")?;
        let factor = frame.camera.width / photo.width;
        let sol = frame.file.get(4..8).ok_or("no sol in the name")?.parse()?;
        let cam_from_site = moved(&frame.cam_from_world, &site_from_scene);
        let shown = demo
            .picture(sol, &cam_from_site, &frame.camera)?
            .box_reduced(factor);
        let row = [
            psnr(&picture("heldout")?, &photo, &[])?,
            psnr(&shown, &photo, &[])?,
        ];
        writeln!(
            stdout,
            "{}",
            json!({"photo": name, "field": row[0], "truth": row[1]})
        )?;
        rows.push(row);
    }
    let mean = |column: usize| rows.iter().map(|row| row[column]).sum::<f64>() / rows.len() as f64;
    writeln!(
        stdout,
        "{}",
        json!({"photos": rows.len(), "field": mean(0), "truth": mean(1)})
    )?;
    Ok(())
}

/// Returns the pose in the site frame of a camera whose world a similarity (rotation with scale, translation) carries there.
fn moved(cam_from_world: &Pose, (scaled, shift): &(Matrix3<f64>, Vector3<f64>)) -> Pose {
    let scale = scaled.determinant().cbrt();
    let rotation = cam_from_world.rotation * (scaled / scale).transpose();
    let centre = scaled * cam_from_world.centre() + shift;
    Pose {
        rotation,
        translation: -(rotation * centre),
    }
}

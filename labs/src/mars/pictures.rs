//! `true-pictures`: the held-out pictures of a training next to pictures of the true scene through the same
//! cameras.
//!
//! `field` is the PSNR of the field's picture against the photo. `truth` is that of the true scene, drawn through the calibrated
//! camera, after the similarity that carries the cameras of the scene to the true ones. Its loss is the cameras' error and the
//! resampling of the photo, and no field can gain it.

use std::{fs, path::Path};

use marf_scene::{Image, Photo, Srgb, metrics::psnr};
use serde_json::json;

use super::truth::{KnownScene, sol_of};
use crate::output::{Result, print_json};

/// Prints both for each held-out photo of a training.
pub fn pictures(dir: &Path) -> Result {
    let known = KnownScene::read(&dir.join("scene.json"))?;
    let site_from_world = known.alignment();
    let KnownScene { demo, scene, .. } = &known;
    let mut rows = Vec::new();
    for frame in scene.frames.iter().filter(|frame| frame.held_out) {
        let name = format!("{}.png", frame.id);
        let picture = |kind: &str| -> Result<Image<Srgb>> {
            Ok(Photo::decode(&fs::read(dir.join(kind).join(&name))?)?.image)
        };
        let photo = picture("photo")?;
        let factor = frame.camera.width / photo.width;
        let sol = sol_of(&frame.file).ok_or("no sol in the name")?;
        let cam_from_site = site_from_world.pose(&frame.cam_from_world);
        let shown = demo.picture(sol, &cam_from_site, &frame.camera)?;
        let field = psnr(&picture("heldout")?, &photo, &[])?;
        let truth = psnr(&shown.box_reduced(factor), &photo, &[])?;
        print_json(&json!({"photo": name, "field": field, "truth": truth}))?;
        rows.push([field, truth]);
    }
    let mean = |column: usize| rows.iter().map(|row| row[column]).sum::<f64>() / rows.len() as f64;
    print_json(&json!({"photos": rows.len(), "field": mean(0), "truth": mean(1)}))
}

//! `plain`: photos of a flat plain with nothing on it but gentle waves of colour. World: metres, z up.

use std::{f64::consts::TAU, path::Path};

use marf_run::files;
use marf_scene::{Image, Srgb, encode_png};
use nalgebra::Vector3;
use serde_json::json;

use crate::output::Result;

/// Height of the cameras, metres. A photo shows the same width of the ground below.
const HEIGHT_M: f64 = 10.0;
/// Tangent of the angle between the cameras and straight down.
const TILT: f64 = 0.25;
/// One photo in this many is held out.
const HELD_OUT_EVERY: usize = 8;

/// A camera over the plain: centre, and the axes right, up, back as columns.
struct Eye {
    centre: Vector3<f64>,
    axes: [Vector3<f64>; 3],
}

impl Eye {
    /// Returns the camera of a number, in a spiral about the origin, tilted about the vertical by the golden angle.
    fn new(index: usize) -> Self {
        let (place, turn) = (index as f64, index as f64 * 2.399_963);
        let apart = 1.2 * place.sqrt();
        let back = Vector3::new(TILT * (2.0 * turn).cos(), TILT * (2.0 * turn).sin(), 1.0).normalize();
        let right = Vector3::new(back.z, 0.0, -back.x).normalize();
        Self {
            centre: Vector3::new(apart * turn.cos(), apart * turn.sin(), HEIGHT_M),
            axes: [right, back.cross(&right), back],
        }
    }

    /// Returns the photo of `side` x `side` pixels, as wide as it is far away.
    fn photo(&self, side: u32, wave_m: f64) -> Image<Srgb> {
        Image::from_fn(side, side, |column, row| {
            let [x, y] = [column, row].map(|place| (f64::from(place) + 0.5) / f64::from(side) - 0.5);
            let [right, up, back] = &self.axes;
            let toward = right * x - up * y - back;
            let place = self.centre + toward * (-self.centre.z / toward.z);
            colour([place.x, place.y], wave_m)
        })
    }

    fn matrix(&self) -> [[f64; 4]; 4] {
        let [right, up, back] = &self.axes;
        let row = |axis: usize| [right[axis], up[axis], back[axis], self.centre[axis]];
        [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    }
}

/// Eight waves in as many directions, each a third longer than the one before.
fn colour([x, y]: [f64; 2], wave_m: f64) -> [u8; 3] {
    let mut levels = [150.0, 110.0, 80.0];
    for wave in 0..8 {
        let (turn, length) = (f64::from(wave) * 2.399_963, wave_m * 1.33_f64.powi(wave));
        let along = (x * turn.cos() + y * turn.sin()) * TAU / length;
        for (channel, level) in levels.iter_mut().enumerate() {
            *level += 10.0 * (along + channel as f64 * 0.4).sin();
        }
    }
    levels.map(|level| level.round().clamp(0.0, 255.0) as u8)
}

/// Writes photos in which the shortest waves are `wave_px` long, and their cameras.
pub fn plain(dir: &Path, wave_px: u32, photos: u32, side_px: u32) -> Result {
    let side = f64::from(side_px);
    let wave_m = f64::from(wave_px) * HEIGHT_M / side;
    let (mut frames, mut training, mut held_out) = (Vec::new(), Vec::new(), Vec::new());
    for index in 0..photos as usize {
        let (eye, name) = (Eye::new(index), format!("images/{index:03}.png"));
        files::write(&dir.join(&name), &encode_png(&eye.photo(side_px, wave_m))?)?;
        frames.push(json!({
            "file_path": name, "transform_matrix": eye.matrix(), "w": side_px, "h": side_px,
            "fl_x": side, "fl_y": side, "cx": side / 2.0, "cy": side / 2.0,
        }));
        if index % HELD_OUT_EVERY == HELD_OUT_EVERY / 2 {
            held_out.push(name);
        } else {
            training.push(name);
        }
    }
    let cameras = json!({
        "camera_model": "PINHOLE",
        "train_filenames": training,
        "test_filenames": held_out,
        "frames": frames,
    });
    let cameras = format!("{cameras:#}\n");
    Ok(files::write(&dir.join("transforms.json"), cameras.as_bytes())?)
}

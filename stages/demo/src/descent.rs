//! A descent: photos of one place from heights that differ 38 times, with cameras that are known exactly.

use rayon::prelude::*;
use serde_json::{Value, json};

use super::{
    Demo, DemoError, DemoFile, IsCancelled,
    ground::OUTCROP,
    lens::Lens,
    math::{DEGREE, SrgbEncoder, Vector, sin_cos, v3},
    truth::pinhole_of,
};

/// Height of the last photo above the ground, metres.
const LOWEST_M: f64 = 1.5;
/// The first photo is 2^5 (1 + 3/16) = 38 times as high.
const OCTAVES: f64 = 5.1875;
/// Distance of a camera from the plumb line over the place, in heights.
const ASIDE: f64 = 0.3;
/// Angle from one camera to the next around the plumb line, degrees (the golden angle): no two are in one
/// direction.
const TURN_DEG: f64 = 137.508;
/// Focal length, widths of a photo: as a descent camera of 53 degrees.
const FOCAL_WIDTHS: f64 = 1.0;
/// One photo in this many is held out.
const HELD_OUT_EVERY: u32 = 8;

impl Demo {
    /// Draws a descent of `count` photos: PNGs below `images/`, and a `transforms.json` that names those to train on and
    /// every eighth as held out.
    ///
    /// The camera looks at one place, from 57 m down to 1.5 m, a fifth of the photos an octave. Its lens has no
    /// distortion. World: the site frame, metres, z down.
    ///
    /// # Errors
    /// [`DemoError::Cancelled`], [`DemoError::Encode`].
    pub fn descent(&self, count: u32, cancelled: IsCancelled<'_>) -> Result<Vec<DemoFile>, DemoError> {
        let encoder = SrgbEncoder::new();
        let photos = (0..count).into_par_iter().map(|index| {
            if cancelled() {
                return Err(DemoError::Cancelled);
            }
            let shot = self.shot(self.world(1), self.descent_lens(index, count));
            let name = descent_file(index);
            let bytes = marf_scene::encode_png(&shot.photo(&encoder));
            let bytes = bytes.map_err(|error| DemoError::encode(name.clone(), error))?;
            Ok(DemoFile { name, bytes })
        });
        let mut files = photos.collect::<Result<Vec<_>, _>>()?;
        files.push(DemoFile {
            name: "transforms.json".to_owned(),
            bytes: format!("{:#}\n", self.descent_cameras(count)).into_bytes(),
        });
        Ok(files)
    }

    /// Returns the camera of a photo in the site frame.
    fn descent_lens(&self, index: u32, count: u32) -> Lens {
        let share = f64::from(index) / f64::from(count.saturating_sub(1).max(1));
        let above = height_m((1.0 - share) * OCTAVES);
        let (sin, cos) = sin_cos(f64::from(index) * TURN_DEG * DEGREE);
        let [x, y] = OUTCROP;
        let ground = v3(x, y, -self.world(1).height(x, y));
        let eye = ground + v3(ASIDE * above * cos, ASIDE * above * sin, -above);
        let forward = (ground - eye).unit();
        let right = forward.cross(&v3(-sin, cos, 0.0)).unit();
        let size_px = [self.options.width_px, self.options.height_px];
        let focal_px = FOCAL_WIDTHS * f64::from(size_px[0]);
        Lens {
            r: [0.0; 3],
            ..Lens::new(eye, forward, right, size_px, focal_px)
        }
    }

    /// Returns the cameras as nerfstudio writes them: camera to world, x right, y up, z back.
    fn descent_cameras(&self, count: u32) -> Value {
        let (width, height) = (self.options.width_px, self.options.height_px);
        let frame = |index: u32| {
            let (cam_from_site, camera) = pinhole_of(&self.descent_lens(index, count), width, height);
            let (rotation, centre) = (cam_from_site.rotation, cam_from_site.centre());
            let row = |axis: usize| {
                let column = rotation.column(axis);
                [column[0], -column[1], -column[2], centre[axis]]
            };
            let matrix = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
            json!({
                "file_path": descent_file(index), "transform_matrix": matrix, "w": width, "h": height,
                "fl_x": camera.fx_px, "fl_y": camera.fy_px, "cx": camera.cx_px, "cy": camera.cy_px,
            })
        };
        let is_held_out = |index: &u32| index % HELD_OUT_EVERY == HELD_OUT_EVERY / 2;
        let (held_out, training): (Vec<u32>, Vec<u32>) = (0..count).partition(is_held_out);
        let names = |indices: Vec<u32>| indices.into_iter().map(descent_file).collect::<Vec<_>>();
        json!({
            "camera_model": "PINHOLE",
            "train_filenames": names(training),
            "test_filenames": names(held_out),
            "frames": (0..count).map(frame).collect::<Vec<_>>(),
        })
    }
}

/// Returns the height `octaves` octaves above the lowest, straight within each.
fn height_m(octaves: f64) -> f64 {
    let whole = octaves as u32;
    LOWEST_M * f64::from(1_u32 << whole) * (1.0 + octaves - f64::from(whole))
}

fn descent_file(index: u32) -> String {
    format!("images/{index:03}.png")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DemoOptions;

    #[test]
    fn a_descent_falls_38_times_by_like_factors_and_ends_at_one_and_a_half_metres() {
        assert_eq!(
            [0.0, 1.0, 1.5, 5.0, OCTAVES].map(height_m),
            [1.5, 3.0, 4.5, 48.0, 57.0]
        );
    }

    #[test]
    fn cameras_of_a_descent_project_the_place_to_their_middles() {
        let demo = Demo::new(DemoOptions {
            width_px: 32,
            height_px: 24,
            seed: 1,
        })
        .unwrap();
        let files = demo.descent(9, &|| false).unwrap();
        assert_eq!(files.len(), 10);
        let cameras: Value = serde_json::from_slice(&files[9].bytes).unwrap();
        assert_eq!(cameras["test_filenames"], json!(["images/004.png"]));
        let [x, y] = OUTCROP;
        let place = [x, y, -demo.world(1).height(x, y)];
        for (index, frame) in cameras["frames"].as_array().unwrap().iter().enumerate() {
            let number = |row: usize, column: usize| frame["transform_matrix"][row][column].as_f64().unwrap();
            let along = |column: usize| -> f64 {
                (0..3)
                    .map(|row| (place[row] - number(row, 3)) * number(row, column))
                    .sum()
            };
            let (right, up, back) = (along(0), along(1), along(2));
            assert!(
                right.abs() < 1e-9 && up.abs() < 1e-9 && back < -1.5,
                "{index}: {right} {up} {back}"
            );
        }
        assert!(matches!(demo.descent(9, &|| true), Err(DemoError::Cancelled)));
    }
}

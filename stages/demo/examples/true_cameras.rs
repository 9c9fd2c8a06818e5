//! Writes the true cameras of the built-in Mars as transforms.json, for `marf trade --truth`:
//! `cargo run --release -p marf-demo --example true_cameras -- 1 2 > truth.json`.

use std::error::Error;
use std::io::Write;

use marf_demo::{Demo, DemoOptions};
use serde_json::json;

fn main() -> Result<(), Box<dyn Error>> {
    let options = DemoOptions::default();
    let (width, height) = (options.width_px, options.height_px);
    let demo = Demo::new(options)?;
    let mut frames = Vec::new();
    for sol in std::env::args().skip(1) {
        for photo in demo.ground_truth(sol.parse()?)?.photos {
            // As calibrate resamples it: the pinhole along the lens's optical axis.
            let pinhole = photo.site_model.linearised(width, height)?;
            let (pose, camera) = (pinhole.cam_from_frame, pinhole.camera);
            let centre = pose.centre();
            // Camera to world, with x right, y up, z back.
            let row = |axis: usize| {
                let of = |column: usize| pose.rotation[(column, axis)];
                [of(0), -of(1), -of(2), centre[axis]]
            };
            frames.push(json!({
                "file_path": photo.file,
                "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
                "w": camera.width, "h": camera.height,
                "fl_x": camera.fx_px, "fl_y": camera.fy_px, "cx": camera.cx_px, "cy": camera.cy_px,
            }));
        }
    }
    if frames.is_empty() {
        return Err("name the sols".into());
    }
    writeln!(
        std::io::stdout(),
        "{:#}",
        json!({"camera_model": "PINHOLE", "frames": frames})
    )?;
    Ok(())
}

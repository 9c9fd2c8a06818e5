//! `true-cameras`: the true cameras of the built-in Mars as transforms.json.

use marf_demo::{Demo, DemoOptions};
use serde_json::json;

use crate::output::{Result, print_line};

/// Prints the cameras of the good photos of sols.
pub fn cameras(sols: &[u32]) -> Result {
    let options = DemoOptions::default();
    let (width, height) = (options.width_px, options.height_px);
    let demo = Demo::new(options)?;
    let mut frames = Vec::new();
    for sol in sols {
        for photo in demo.ground_truth(*sol)?.photos {
            // As calibrate resamples it: the pinhole along the lens's optical axis.
            let pinhole = photo.site_model.linearised(width, height)?;
            let (pose, camera) = (pinhole.cam_from_frame, pinhole.camera);
            let (rotation, centre) = (pose.rotation, pose.centre());
            // Camera to world, with x right, y up, z back.
            let row = |axis: usize| {
                let column = rotation.column(axis);
                [column[0], -column[1], -column[2], centre[axis]]
            };
            frames.push(json!({
                "file_path": photo.file,
                "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
                "w": camera.width, "h": camera.height,
                "fl_x": camera.fx_px, "fl_y": camera.fy_px, "cx": camera.cx_px, "cy": camera.cy_px,
            }));
        }
    }
    print_line(&format!(
        "{:#}",
        json!({"camera_model": "PINHOLE", "frames": frames})
    ));
    Ok(())
}

//! A scene as transforms.json, which nerfstudio and instant-ngp read.

use marf_scene::{Camera, Frame, Pose, Scene};
use serde::Serialize;

#[derive(Serialize)]
struct Transforms<'a> {
    camera_model: &'static str,
    #[serde(flatten)]
    camera: Option<Lens>,
    train_filenames: Vec<&'a str>,
    val_filenames: Vec<&'a str>,
    test_filenames: Vec<&'a str>,
    frames: Vec<Entry<'a>>,
}

#[derive(Serialize)]
struct Entry<'a> {
    file_path: &'a str,
    #[serde(flatten)]
    camera: Option<Lens>,
    transform_matrix: [[f64; 4]; 4],
}

#[derive(Serialize)]
struct Lens {
    w: u32,
    h: u32,
    fl_x: f64,
    fl_y: f64,
    cx: f64,
    cy: f64,
    k1: f64,
    k2: f64,
    p1: f64,
    p2: f64,
}

impl Lens {
    fn of(camera: &Camera) -> Self {
        Self {
            w: camera.width,
            h: camera.height,
            fl_x: camera.fx_px,
            fl_y: camera.fy_px,
            cx: camera.cx_px,
            cy: camera.cy_px,
            k1: camera.k1,
            k2: camera.k2,
            p1: camera.p1,
            p2: camera.p2,
        }
    }
}

/// Writes a scene in the nerfstudio convention: camera to world, x right, y up, z backward; lens terms of
/// OpenCV; frames sorted by file name; held-out photos as test and validation, the others as training.
///
/// One camera for all frames stands at the top, different ones stand with their frames. The world is the
/// scene's own, neither turned nor scaled. The names are those of [`Frame::file`], relative to where the file
/// is put; photos that were encoded anew have the extension `.png` there.
pub fn write_transforms(scene: &Scene) -> String {
    let mut frames: Vec<&Frame> = scene.frames.iter().collect();
    frames.sort_by(|a, b| (&a.file, &a.id).cmp(&(&b.file, &b.id)));
    let shared = frames.first().map(|frame| frame.camera);
    let shared = shared.filter(|camera| frames.iter().all(|frame| frame.camera == *camera));
    let names = |held_out: bool| {
        let chosen = frames.iter().filter(|frame| frame.held_out == held_out);
        chosen.map(|frame| frame.file.as_str()).collect::<Vec<_>>()
    };
    let entries = frames.iter().map(|frame| Entry {
        file_path: &frame.file,
        camera: shared.is_none().then(|| Lens::of(&frame.camera)),
        transform_matrix: opengl(&frame.cam_from_world),
    });
    let transforms = Transforms {
        camera_model: "OPENCV",
        camera: shared.as_ref().map(Lens::of),
        train_filenames: names(false),
        val_filenames: names(true),
        test_filenames: names(true),
        frames: entries.collect(),
    };
    // Finite numbers and strings always serialise.
    serde_json::to_string_pretty(&transforms).unwrap_or_default()
}

/// Camera to world with y up and z backward: [Rᵀ diag(1, -1, -1) | C].
fn opengl(cam_from_world: &Pose) -> [[f64; 4]; 4] {
    let (r, centre) = (cam_from_world.rotation, cam_from_world.centre());
    let row = |i: usize| [r[(0, i)], -r[(1, i)], -r[(2, i)], centre[i]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

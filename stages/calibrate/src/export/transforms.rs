//! A scene as transforms.json, which nerfstudio and instant-ngp read.

use marf_scene::{Camera, Frame, Pose, Scene};
use marf_schema::output::POINTS;
use serde::Serialize;

/// transforms.json.
#[derive(Serialize)]
struct Transforms {
    camera_model: &'static str,
    #[serde(flatten)]
    camera: Option<Lens>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ply_file_path: Option<&'static str>,
    train_filenames: Vec<String>,
    val_filenames: Vec<String>,
    test_filenames: Vec<String>,
    frames: Vec<Entry>,
}

/// A frame of it.
#[derive(Serialize)]
struct Entry {
    file_path: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    mask_path: Option<String>,
    #[serde(flatten)]
    camera: Option<Lens>,
    transform_matrix: [[f64; 4]; 4],
}

/// Intrinsics, at the top or of a frame.
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
    fn new(camera: &Camera) -> Self {
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

/// Writes a scene in the nerfstudio convention: camera to world, x right, y up, z backward, lens terms of OpenCV.
///
/// Frames are sorted by file name. Held-out photos are test and validation, the others training. A camera shared by all frames is at the
/// top, different ones are in their frames. The world is the scene's own, neither rotated nor scaled. `path_of` returns the path of a photo
/// relative to the file's folder: [`Frame::file`] if photos are in the same folder. Re-encoded photos have the extension `.png` there.
/// `mask_of` returns the path of its mask, if it has one. A scene with sparse points names [`POINTS`], a file in the same folder.
pub fn write_transforms(
    scene: &Scene,
    path_of: &dyn Fn(&Frame) -> String,
    mask_of: &dyn Fn(&Frame) -> Option<String>,
) -> String {
    let mut frames: Vec<&Frame> = scene.frames.iter().collect();
    frames.sort_by(|a, b| (&a.file, &a.id).cmp(&(&b.file, &b.id)));
    let shared = frames.first().map(|frame| frame.camera);
    let shared = shared.filter(|camera| frames.iter().all(|frame| frame.camera == *camera));
    let names = |held_out: bool| {
        let chosen = frames.iter().filter(|frame| frame.held_out == held_out);
        chosen.map(|frame| path_of(frame)).collect::<Vec<_>>()
    };
    let entries = frames.iter().map(|frame| Entry {
        file_path: path_of(frame),
        mask_path: mask_of(frame),
        camera: shared.is_none().then(|| Lens::new(&frame.camera)),
        transform_matrix: opengl(&frame.cam_from_world),
    });
    let transforms = Transforms {
        camera_model: "OPENCV",
        camera: shared.as_ref().map(Lens::new),
        ply_file_path: (!scene.points.is_empty()).then_some(POINTS),
        train_filenames: names(false),
        val_filenames: names(true),
        test_filenames: names(true),
        frames: entries.collect(),
    };
    // Finite numbers and strings always serialise.
    serde_json::to_string_pretty(&transforms).unwrap_or_default()
}

/// Returns the path of a photo in the folder of transforms.json.
pub fn beside(frame: &Frame) -> String {
    frame.file.clone()
}

/// Camera to world with y up and z backward: [Rᵀ diag(1, -1, -1) | C].
fn opengl(cam_from_world: &Pose) -> [[f64; 4]; 4] {
    let (r, centre) = (cam_from_world.rotation, cam_from_world.centre());
    let row = |i: usize| [r[(0, i)], -r[(1, i)], -r[(2, i)], centre[i]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

#[cfg(test)]
mod tests {
    use marf_cache::Digest;
    use marf_scene::Point;
    use nalgebra::Vector3;

    use super::*;
    use crate::import::read_transforms;
    use crate::{Tracks, write_ply};

    /// One camera off every axis, and points around what it looks at.
    fn scene() -> Scene {
        let eye = Vector3::new(3.0, -4.0, 2.5);
        let point = |position| Point {
            position,
            color: Some([9, 8, 7]),
            views: 2,
        };
        let frame = Frame {
            id: "a".to_owned(),
            file: "images/a.jpg".to_owned(),
            image: Digest::from_content(b"a"),
            camera: Camera::pinhole(640, 480, 500.0),
            cam_from_world: Pose::looking_at(eye, Vector3::zeros(), -Vector3::z()),
            held_out: false,
            mask: None,
            error_px: None,
        };
        Scene {
            frames: vec![frame],
            points: [[0.0, 0.0, 0.0], [1.0, 0.3, -0.2], [-0.7, 0.9, 0.4]]
                .map(point)
                .into(),
            ..Scene::default()
        }
    }

    #[test]
    fn points_come_back_to_the_same_pixels() {
        let scene = scene();
        let read = read_transforms(
            "transforms.json",
            write_transforms(&scene, &beside, &|_| None).as_bytes(),
        )
        .unwrap();
        assert_eq!(read.points.as_deref(), Some("points.ply"));
        let written = write_ply(&Tracks::without_observations(&scene.points));
        let points = marf_scene::ply::read_points(&written).unwrap();
        let (before, after) = (&scene.frames[0], &read.views[0]);
        let camera = after.lens.camera(640, 480).unwrap();
        for (ours, theirs) in scene.points.iter().zip(&points) {
            let seen = |camera: &Camera, pose: &Pose, point: &Point| {
                camera
                    .project(&pose.point(&Vector3::from(point.position)))
                    .unwrap()
            };
            let pixel = seen(&before.camera, &before.cam_from_world, ours);
            let again = seen(&camera, &after.cam_from_world, theirs);
            // f32 moves a point by 6e-8 of its distance from the origin: 1e-5 px here.
            assert!((pixel - again).norm() < 1e-4, "{pixel} {again}");
            assert_eq!(theirs.color, ours.color);
        }
    }

    #[test]
    fn a_scene_without_points_names_no_file_of_points() {
        let bare = Scene {
            points: Vec::new(),
            ..scene()
        };
        assert!(!write_transforms(&bare, &beside, &|_| None).contains("ply_file_path"));
    }
}

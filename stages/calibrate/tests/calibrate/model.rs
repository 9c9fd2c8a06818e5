//! COLMAP models next to the photos, and the model that is written.

use marf_calibrate::import::{Model, read_colmap_binary};
use marf_scene::{Image, Srgb, encode_png};
use serde_json::json;

use crate::common::Input;

/// Two photos, and a model of twice their size next to them.
fn input() -> Input {
    let picture = Image::<Srgb>::from_fn(64, 48, |x, y| [x * 4, y * 5, 40].map(|value| value as u8));
    let mut input = Input::default();
    for name in ["images/a.png", "images/b.png"] {
        input.plain(name, &encode_png(&picture).unwrap());
    }
    input.companion("sparse/0/cameras.txt", b"1 SIMPLE_RADIAL 128 96 100 64 48 0.01\n");
    input.companion(
        "sparse/0/images.txt",
        b"1 1 0 0 0 0 0 0 1 a.png\n64 48 3\n2 1 0 0 0 1 0 0 1 b.png\n\n",
    );
    input.companion("sparse/0/points3D.txt", b"3 0 0 5 1 2 3 0.1 1 0\n");
    input
}

#[test]
fn a_colmap_model_beside_the_photos_is_read() {
    let input = input();
    let output = input.run(&json!({"method": "import"})).unwrap();
    let frame = &output.scene.frames[0];
    // The photo has half the size of the camera.
    assert_eq!(
        (frame.camera.width, frame.camera.fx_px, frame.camera.cx_px),
        (64, 50.0, 32.0)
    );
    assert_eq!(frame.error_px, Some(0.0));
    assert_eq!(output.scene.points.len(), 1);
    assert_eq!(output.scene.up, None);
    let photo = &output.metrics.photos[0];
    assert_eq!((photo.matches, photo.inliers), (Some(1), Some(1)));
    assert_eq!(output.metrics.totals.error_px, Some(0.0));
    let named = input
        .run(&json!({"method": "import", "file": "sparse/0"}))
        .unwrap();
    assert_eq!(named.scene_digest, output.scene_digest);
    let complaint = input.complaint(&json!({"method": "import", "file": "transforms.json"}));
    assert!(
        complaint.contains("`transforms.json` is not a file with cameras next to the photos"),
        "{complaint}"
    );
}

#[test]
fn the_model_that_is_written_says_the_same_and_the_points_are_there_to_look_at() {
    let output = input().run(&json!({"method": "import"})).unwrap();
    let model = Model {
        names: ["cameras", "images", "points3D"],
        cameras: &output.model[0],
        images: &output.model[1],
        points: Some(&output.model[2]),
    };
    let again = read_colmap_binary(&model).unwrap();
    assert_eq!(
        again.views[1].cam_from_world,
        output.scene.frames[1].cam_from_world
    );
    assert_eq!(again.points[0].position, output.scene.points[0].position);
    assert!(
        output
            .points
            .starts_with(b"ply\nformat binary_little_endian 1.0\nelement vertex 1\n")
    );
}

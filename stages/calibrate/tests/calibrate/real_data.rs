//! Real photos with the cameras they came with.

use marf_scene::Photo;
use nalgebra::{Vector2, Vector3};
use serde_json::json;

use crate::common::{Input, folder, shared};

fn import(name: &str, json: &str, photos: &str) -> Option<Input> {
    let root = shared(name)?.join(name);
    let mut input = Input::default();
    folder(&mut input, &root, photos);
    input.companion(json, &std::fs::read(root.join(json)).unwrap());
    Some(input)
}

#[test]
fn the_rover_has_92_cameras_for_98_photos() {
    let Some(input) = import("rover", "transforms.json", "images") else {
        return;
    };
    let output = input
        .run(&json!({"method": "import", "hold": "every", "find_points": false}))
        .unwrap();
    let totals = &output.metrics.totals;
    assert_eq!(
        (totals.photos, totals.registered, totals.unplaced, totals.missing),
        (98, 92, 6, 0)
    );
    // Every 8th of 92: 0, 8, ..., 88.
    assert_eq!(totals.held_out, 12);
    assert_eq!(output.scene.unplaced.len(), 6);
    assert_eq!(
        output.scene.unplaced[0].reason,
        "transforms.json has no camera for it"
    );
    let frame = &output.scene.frames[0];
    assert_eq!((frame.camera.width, frame.camera.height), (1440, 1920));
    assert_eq!(frame.camera.k2, -0.13139700421486492);
    // The authors' tool turned the world until z pointed up.
    let up = output.scene.up.unwrap();
    assert!(up[2] > 0.99, "{up:?}");
    assert_eq!(output.scene.metres_per_unit, None);
    let ring: Vec<f64> = output
        .scene
        .frames
        .iter()
        .map(|frame| frame.cam_from_world.centre().norm())
        .collect();
    assert!(ring.iter().all(|range| (1.0..9.0).contains(range)), "{ring:?}");
}

#[test]
fn the_small_rover_keeps_its_own_test_photos() {
    let Some(input) = import("rover4", "transforms.json", "images") else {
        return;
    };
    let output = input
        .run(&json!({"method": "import", "find_points": false}))
        .unwrap();
    let held_out: Vec<&str> = output
        .scene
        .frames
        .iter()
        .filter(|frame| frame.held_out)
        .map(|frame| frame.file.as_str())
        .collect();
    assert_eq!(held_out.len(), 12);
    assert!(held_out.contains(&"images/frame_00042.png"), "{held_out:?}");
    assert_eq!(output.metrics.totals.registered, 92);
    assert_eq!(output.scene.frames[0].camera.width, 360);
}

#[test]
fn cameras_of_the_large_rover_fit_the_small_photos() {
    let Some(mut input) = import("rover4", "transforms.json", "images") else {
        return;
    };
    let small = input
        .run(&json!({"method": "import", "find_points": false}))
        .unwrap()
        .scene;
    let large = shared("rover").unwrap().join("rover/transforms.json");
    input.companion("transforms.json", &std::fs::read(large).unwrap());
    let scaled = input
        .run(&json!({"method": "import", "find_points": false}))
        .unwrap()
        .scene;
    assert_eq!(scaled.frames.len(), 92);
    for (scaled, small) in scaled.frames.iter().zip(&small.frames) {
        assert_eq!(scaled.id, small.id);
        assert!(
            (scaled.camera.fx_px - small.camera.fx_px).abs() < 1e-9,
            "{}",
            scaled.id
        );
        assert!(
            (scaled.camera.cy_px - small.camera.cy_px).abs() < 1e-9,
            "{}",
            scaled.id
        );
        assert!((scaled.cam_from_world.centre() - small.cam_from_world.centre()).norm() < 1e-9);
    }
}

#[test]
fn the_fox_lists_67_photos_and_50_are_there() {
    let Some(input) = import("fox", "transforms.json", "images") else {
        return;
    };
    let output = input
        .run(&json!({"method": "import", "longest_side_px": 480, "find_points": false}))
        .unwrap();
    let totals = &output.metrics.totals;
    assert_eq!((totals.registered, totals.unplaced, totals.missing), (50, 0, 17));
    assert!(output.metrics.missing[0].reason.contains("not among the photos"));
    let frame = &output.scene.frames[0];
    assert_eq!(
        (frame.camera.width, frame.camera.height, frame.file.as_str()),
        (270, 480, "images/0001.png")
    );
    let image = Photo::decode(&input.harness.get(&frame.image).unwrap())
        .unwrap()
        .image;
    assert_eq!((image.width, image.height), (270, 480));
}

#[test]
fn the_lego_set_names_photos_without_extension() {
    let Some(input) = import("lego", "transforms_train.json", "train") else {
        return;
    };
    let output = input
        .run(&json!({"method": "import", "hold": "every", "hold_every": 10, "find_points": false}))
        .unwrap();
    let totals = &output.metrics.totals;
    assert_eq!(
        (totals.registered, totals.unplaced, totals.held_out),
        (100, 0, 10)
    );
    let camera = output.scene.frames[0].camera;
    // 200 / tan(0.6911112 / 2): known of the set as 1111.1 px for 800.
    assert!((camera.fx_px - 555.5555).abs() < 1e-3, "{}", camera.fx_px);
    // Every camera of the set looks at the origin from 4 units.
    for frame in &output.scene.frames {
        let origin = frame.cam_from_world.point(&Vector3::zeros());
        let seen = frame.camera.project(&origin).unwrap();
        assert!(
            (seen - Vector2::new(200.0, 200.0)).norm() < 1e-3,
            "{}: {seen}",
            frame.id
        );
        assert!(
            (origin.norm() - 4.031).abs() < 1e-2,
            "{}: {}",
            frame.id,
            origin.norm()
        );
    }
}

#[test]
fn what_is_written_reads_back_to_the_same_scene() {
    let Some(mut input) = import("fox4", "transforms.json", "images") else {
        return;
    };
    let first = input.run(&json!({"method": "import"})).unwrap();
    input.companion("transforms.json", first.transforms.as_bytes());
    input.companion("points.ply", &first.points);
    let second = input.run(&json!({"method": "import"})).unwrap();
    for (a, b) in first.scene.frames.iter().zip(&second.scene.frames) {
        assert_eq!(
            (&a.id, a.held_out, a.camera, a.image),
            (&b.id, b.held_out, b.camera, b.image)
        );
        let moved = (a.cam_from_world.centre() - b.cam_from_world.centre()).norm();
        assert!(moved < 1e-13, "{}: {moved}", a.id);
    }
    assert_eq!(first.scene.frames.len(), second.scene.frames.len());
    // The file names no points: 43 photos to train on show 2,501, .4 px from where they see them.
    let count = first.scene.points.len();
    assert!((2_000..3_000).contains(&count), "{count}");
    assert!(
        first.metrics.totals.error_px.unwrap() < 0.6,
        "{:?}",
        first.metrics.totals
    );
    assert_eq!(second.scene.points.len(), count);
}

//! Distances of pixels that pull: when pairs give them, and from which photos.

use marf_field::DepthSource;
use marf_scene::{Image, Point, Pose, Scene, encode_png};
use marf_schema::train::Setup;
use marf_stage::{Outputs, TypedOutputs, harness::Harness};
use marf_train::Train;
use nalgebra::{Vector2, Vector3};
use serde_json::{Value, json};

use crate::common::{inputs, put_scene, run, scene_of, small, stage};

/// Returns a number in [0, 1) of a place on a grid.
fn noise(x: i64, y: i64) -> f64 {
    let mixed =
        (x.wrapping_mul(0x9e37_79b9) ^ y.wrapping_mul(0x85eb_ca6b)).wrapping_mul(0x27d4_eb2f_1656_67c5);
    f64::from(((mixed ^ (mixed >> 29)) & 0xff) as u8) / 256.0
}

/// Brightness of the floor: smooth noise.
fn brightness(x: f64, y: f64) -> u8 {
    let (x, y) = (6.0 * x, 6.0 * y);
    let (i, j, u, v) = (x.floor() as i64, y.floor() as i64, x - x.floor(), y - y.floor());
    let row = |j: i64| noise(i, j) * (1.0 - u) + noise(i + 1, j) * u;
    (30.0 + 200.0 * (row(j) * (1.0 - v) + row(j + 1) * v)) as u8
}

/// A floor z = 0 with points on it, photographed from above on a line. z points down.
fn floor(harness: &Harness, photos: u32) -> Scene {
    let points = (0..400).map(|index| Point {
        position: [
            f64::from(index % 20) * 0.2 - 1.9,
            f64::from(index / 20) * 0.2 - 1.9,
            0.0,
        ],
        color: None,
        views: 3,
    });
    let mut scene = Scene {
        points: points.collect(),
        ..scene_of(harness, photos, 96, 72)
    };
    for (index, frame) in scene.frames.iter_mut().enumerate() {
        let x = 0.15 * (index as f64 - f64::from(photos) / 2.0);
        let eye = Vector3::new(x, 0.1, -3.0);
        frame.cam_from_world = Pose::looking_at(eye, Vector3::new(x, 0.0, 0.0), Vector3::y());
        let world_from_cam = frame.cam_from_world.inverse();
        let image = Image::from_fn(96, 72, |column, row| {
            let pixel = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let ray = world_from_cam.direction(&frame.camera.unproject(&pixel).unwrap());
            let hit = eye - ray * (eye.z / ray.z);
            [brightness(hit.x, hit.y); 3]
        });
        frame.image = harness.put(&encode_png(&image).unwrap());
    }
    scene
}

fn trained(harness: &Harness, scene: &Scene, keys: &Value) -> (Outputs, Setup) {
    trained_for(harness, scene, 48, keys)
}

fn trained_for(harness: &Harness, scene: &Scene, steps: u64, keys: &Value) -> (Outputs, Setup) {
    let mut field = small();
    let both = field.as_object_mut().unwrap();
    both.extend(keys.as_object().unwrap().clone());
    let train: Train = stage(json!({"steps": steps, "field": field, "judged_scale": 8}));
    let outputs = run(
        &train,
        &harness.ctx(),
        &inputs(&[("scene", put_scene(harness, scene))]),
    )
    .unwrap();
    let setup = outputs.read(&harness.ctx()).unwrap();
    (outputs, setup)
}

#[test]
fn pairs_of_few_photos_give_distances_and_a_key_decides_otherwise() {
    let harness = Harness::default();
    let few = floor(&harness, 16);
    let (by_rule, setup) = trained(&harness, &few, &json!({}));
    assert_eq!(setup.config.depth_source, DepthSource::Pairs);
    let reason = &setup.derived.sizes.depth_steps.reason;
    assert!(reason.contains("12 photos to train on"), "{reason}");
    assert!(reason.contains("distances from pairs of them"), "{reason}");
    let (by_key, setup) = trained(&harness, &few, &json!({"depth_source": "points"}));
    assert_eq!(setup.config.depth_source, DepthSource::Points);
    assert_ne!(by_rule["weights"], by_key["weights"]);
}

/// 32 photos are 24 to train on, and 16 steps for each are 384.
#[test]
fn pairs_of_many_photos_give_distances_from_16_steps_a_photo_on() {
    let harness = Harness::default();
    let many = floor(&harness, 32);
    for (steps, expected) in [(383, DepthSource::Points), (384, DepthSource::Pairs)] {
        let (_, setup) = trained_for(&harness, &many, steps, &json!({}));
        assert_eq!(setup.config.depth_source, expected, "{steps}");
        let reason = &setup.derived.sizes.depth_steps.reason;
        assert_eq!(
            reason.contains("distances from pairs of them would blur what 24 photos show"),
            expected == DepthSource::Pairs,
            "{reason}"
        );
    }
}

#[test]
fn photos_that_judge_take_no_part_in_pairs() {
    let harness = Harness::default();
    let mut scene = floor(&harness, 16);
    let (before, setup) = trained(&harness, &scene, &json!({}));
    let reason = setup.derived.sizes.depth_steps.reason;
    assert!(reason.contains("distances from pairs of them"), "{reason}");
    let black = encode_png(&Image::from_fn(96, 72, |_, _| [0; 3])).unwrap();
    for frame in scene.frames.iter_mut().filter(|frame| frame.held_out) {
        frame.image = harness.put(&black);
    }
    let (after, _) = trained(&harness, &scene, &json!({}));
    assert_eq!(before["weights"], after["weights"]);
}

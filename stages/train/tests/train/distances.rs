//! Distances of pixels that pull: when pairs give them, and from which photos.

use marf_field::DepthSource;
use marf_scene::{Image, Point, Scene, encode_png};
use marf_schema::train::Setup;
use marf_stage::{Outputs, TypedOutputs, harness::Harness};
use marf_train::Train;
use serde_json::{Value, json};

use crate::common::{inputs, put_scene, run, scene_of, small, stage};

/// The checkered floor with points on it, in photos large enough to be matched.
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
    Scene {
        points: points.collect(),
        ..scene_of(harness, photos, 96, 72)
    }
}

fn trained(harness: &Harness, scene: &Scene, keys: &Value) -> (Outputs, Setup) {
    let mut field = small();
    let both = field.as_object_mut().unwrap();
    both.extend(keys.as_object().unwrap().clone());
    let train: Train = stage(json!({"steps": 48, "field": field, "judged_scale": 8}));
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
    // 32 photos are 24 to train on.
    let (_, setup) = trained(&harness, &floor(&harness, 32), &json!({}));
    assert_eq!(setup.config.depth_source, DepthSource::Points);
}

#[test]
fn photos_that_judge_take_no_part_in_pairs() {
    let harness = Harness::default();
    let mut scene = floor(&harness, 16);
    let (before, _) = trained(&harness, &scene, &json!({}));
    let black = encode_png(&Image::from_fn(96, 72, |_, _| [0; 3])).unwrap();
    for frame in scene.frames.iter_mut().filter(|frame| frame.held_out) {
        frame.image = harness.put(&black);
    }
    let (after, _) = trained(&harness, &scene, &json!({}));
    assert_eq!(before["weights"], after["weights"]);
}

//! A member of a bootstrap is the training that its port `training` names, with another seed or draw of photos.

use crate::common::{inputs, json, put_scene, run, scene, small, stage};
use marf_cache::Digest;
use marf_scene::Point;
use marf_stage::{Expand, Outputs, harness::Harness};
use marf_train::{Bootstrap, Train};
use serde_json::{Value, json};

struct Delivered {
    harness: Harness,
    scene: Digest,
    outputs: Outputs,
}

/// A training whose sizes follow from the scene and whose parts were tried, on photos shrunk and thinned.
fn delivered(points: bool) -> Delivered {
    let harness = Harness::default();
    let mut scene = scene(&harness, 12);
    let point = |index: u32| Point {
        position: [
            f64::from(index % 8) / 4.0 - 1.0,
            f64::from(index / 8) / 4.0 - 1.0,
            0.0,
        ],
        color: None,
        views: 3,
    };
    if points {
        scene.points = (0..64).map(point).collect();
    }
    let scene = put_scene(&harness, &scene);
    let mut field = small();
    for derived in ["levels", "log2_table", "finest_resolution"] {
        field.as_object_mut().unwrap().remove(derived);
    }
    let table = json!({"quality": "standard", "steps": 24, "scale": 2, "field": field});
    let train: Train = stage(table);
    let outputs = run(&train, &harness.ctx(), &inputs(&[("scene", scene)])).unwrap();
    Delivered {
        harness,
        scene,
        outputs,
    }
}

impl Delivered {
    /// Trains the second member of a bootstrap.
    fn member(&self, mode: &str, setup: bool) -> Outputs {
        let bootstrap: Bootstrap = stage(json!({"b": 2, "mode": mode}));
        let mut of = inputs(&[("scene", self.scene)]);
        if setup {
            of.0.insert("setup".to_owned(), self.outputs["setup"]);
        }
        let mut nodes = bootstrap.expand(&self.harness.ctx(), &of).unwrap();
        let node = nodes.remove(1);
        let mut params = node.params;
        if !setup {
            params["steps"] = json!(24);
        }
        run(&stage::<Train>(params), &self.harness.ctx(), &node.inputs).unwrap()
    }

    fn document(&self, outputs: &Outputs, name: &str) -> Value {
        json(&self.harness, outputs, name)
    }
}

#[test]
fn a_member_has_the_resolved_configuration_of_its_training_field_by_field() {
    for points in [false, true] {
        let train = delivered(points);
        let setup = train.document(&train.outputs, "setup");
        for mode in ["seeds", "photos"] {
            let member = train.member(mode, true);
            let of_member = train.document(&member, "setup");
            for (field, value) in setup.as_object().unwrap() {
                assert_eq!(&of_member[field], value, "{mode}, points {points}: {field}");
            }
            assert_eq!(train.outputs["setup"], member["setup"], "{mode}");
            let [own, other] = [&train.outputs, &member].map(|outputs| train.document(outputs, "metrics"));
            for field in [
                "config",
                "steps",
                "scale",
                "holdout",
                "fit",
                "thinned",
                "held_out_photos",
            ] {
                assert_eq!(own[field], other[field], "{mode}: metrics.{field}");
            }
            for field in ["origin", "half_side", "near", "far", "levels", "sizes"] {
                assert_eq!(
                    own["field"][field], other["field"][field],
                    "{mode}: field.{field}"
                );
            }
            assert_eq!((&own["seed"], &other["seed"]), (&json!(0), &json!(1)));
            assert_ne!(train.outputs["weights"], member["weights"], "{mode}");
            let fewer = other["train_photos"].as_u64() < own["train_photos"].as_u64();
            assert_eq!(fewer, mode == "photos", "{mode}: {}", other["train_photos"]);
        }
    }
}

/// What the test above would miss if it compared nothing: fewer photos ask for another box.
#[test]
fn without_a_training_to_follow_the_photos_drawn_decide_box_and_sizes() {
    let train = delivered(false);
    let setup = train.document(&train.outputs, "setup");
    let member = train.document(&train.member("photos", false), "setup");
    assert_ne!(setup["derived"]["half_side"], member["derived"]["half_side"]);
    assert_ne!(setup["scale"], member["scale"]);
}

#[test]
fn the_first_member_with_the_seed_of_its_training_is_that_training() {
    let train = delivered(true);
    let of = inputs(&[("scene", train.scene), ("setup", train.outputs["setup"])]);
    let again = run(&stage::<Train>(json!({})), &train.harness.ctx(), &of).unwrap();
    assert_eq!(again["heldout/002.png"], train.outputs["heldout/002.png"]);
    assert_eq!(again["curve"], train.outputs["curve"]);
    let junk = train.harness.put(b"{}");
    let of = inputs(&[("scene", train.scene), ("setup", junk)]);
    let error = run(&stage::<Train>(json!({})), &train.harness.ctx(), &of).unwrap_err();
    assert!(
        error
            .to_string()
            .starts_with("the input `setup` is not what `train` writes"),
        "{error}"
    );
}

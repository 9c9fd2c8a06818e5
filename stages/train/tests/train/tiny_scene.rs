//! Every stage of this crate on a tiny scene, with the real field.

use crate::common::{self, inputs, json, put_scene, run, scene, small, stage};
use marf_cache::Digest;
use marf_scene::Photo;
use marf_stage::{Define, Expand, Outputs, StageError, harness::Harness};
use marf_train::{Bootstrap, Evaluate, Render, Train, Tune};
use serde_json::{Value, json};

const STEPS: u64 = 32;

fn table(more: &Value) -> Value {
    let mut table = json!({"steps": STEPS, "field": small()});
    let both = table.as_object_mut().unwrap();
    both.extend(more.as_object().unwrap().clone());
    table
}

fn trained(harness: &Harness, more: Value) -> Outputs {
    let scene = put_scene(harness, &scene(harness, 12));
    let train: Train = stage(table(&more));
    run(&train, &harness.ctx(), &inputs(&[("scene", scene)])).unwrap()
}

#[test]
fn training_learns_the_floor_and_tells_what_it_did() {
    let harness = Harness::default();
    let outputs = trained(&harness, json!({"steps": 160}));
    let metrics = json(&harness, &outputs, "metrics");
    let curve = json(&harness, &outputs, "curve");
    let psnr = |value: &Value| value["psnr"].as_f64().unwrap();
    assert!(psnr(&metrics) > 13.0, "{metrics}");
    assert!(psnr(&curve[8]) > psnr(&curve[0]) + 1.0, "{curve}");
    assert_eq!(
        (&metrics["train_photos"], &metrics["held_out_photos"]),
        (&json!(9), &json!(3))
    );
    assert_eq!((&metrics["steps"], &metrics["scale"]), (&json!(160), &json!(1)));
    assert_eq!(metrics["rays"], curve[8]["rays"]);
    assert_eq!(metrics["views"][0]["name"], "002");
    let picture = Photo::decode(&harness.get(&outputs["heldout/002.png"]).unwrap())
        .unwrap()
        .image;
    assert_eq!((picture.width, picture.height), (common::WIDTH, common::HEIGHT));
    let photo = Photo::decode(&harness.get(&outputs["photo/002.png"]).unwrap())
        .unwrap()
        .image;
    let again = marf_scene::metrics::psnr(&picture, &photo, &[]).unwrap();
    assert_eq!(json!(again), metrics["views"][0]["psnr"]);
}

#[test]
fn one_seed_gives_one_field_and_another_seed_another() {
    let weights = |seed: u64| trained(&Harness::default(), json!({ "seed": seed }))["weights"];
    assert_eq!(weights(0), weights(0));
    assert_ne!(weights(0), weights(1));
    assert_ne!(weights(0), weights(1 << 32), "the upper half of the seed counts");
}

#[test]
fn validation_holds_out_training_photos_and_a_bootstrap_sample_names_its_draw() {
    let harness = Harness::default();
    let outputs = trained(&harness, json!({"holdout": "validation", "resample": 5}));
    let metrics = json(&harness, &outputs, "metrics");
    let ids = |list: &Value| list.as_array().unwrap().len();
    assert_eq!(ids(&metrics["drawn"]), 8);
    assert_eq!(metrics["held_out_photos"], 1);
    assert!(metrics["train_photos"].as_u64().unwrap() < 8, "{metrics}");
    let views = metrics["views"].as_array().unwrap();
    let test = ["002", "006", "010"];
    assert!(
        views
            .iter()
            .all(|view| !test.contains(&view["id"].as_str().unwrap())),
        "{metrics}"
    );
}

#[test]
fn chosen_parameters_lie_over_the_defaults_and_under_the_nodes_own_keys() {
    let harness = Harness::default();
    let chosen = harness.put(br#"{"field": {"learning_rate": 0.005, "levels": 8}}"#);
    let scene = put_scene(&harness, &scene(&harness, 8));
    let train: Train = stage(table(&json!({})));
    let outputs = run(
        &train,
        &harness.ctx(),
        &inputs(&[("scene", scene), ("params", chosen)]),
    )
    .unwrap();
    let config = &json(&harness, &outputs, "metrics")["config"];
    assert_eq!(
        (&config["learning_rate"], &config["levels"]),
        (&json!(0.005), &json!(4))
    );

    let wrong = harness.put(br#"{"field": {"lerning_rate": 0.005}}"#);
    let error = run(
        &train,
        &harness.ctx(),
        &inputs(&[("scene", scene), ("params", wrong)]),
    )
    .unwrap_err();
    assert!(error.to_string().contains("lerning_rate"), "{error}");
}

#[test]
fn photos_are_shrunk_before_training() {
    let harness = Harness::default();
    let outputs = trained(&harness, json!({"scale": 2}));
    let picture = Photo::decode(&harness.get(&outputs["heldout/002.png"]).unwrap())
        .unwrap()
        .image;
    assert_eq!((picture.width, picture.height), (12, 9));
    let metrics = json(&harness, &outputs, "metrics");
    assert_eq!(
        metrics["ssim"],
        Value::Null,
        "9 rows are fewer than a window's 11"
    );
}

/// Whatever the held-out photos show, the field is the same.
#[test]
fn held_out_photos_decide_nothing() {
    let harness = Harness::default();
    let outputs = trained(&harness, json!({}));
    let mut other = scene(&harness, 12);
    let swap = other.frames[0].image;
    other
        .frames
        .iter_mut()
        .filter(|frame| frame.held_out)
        .for_each(|frame| frame.image = swap);
    let train: Train = stage(table(&json!({})));
    let blind = run(
        &train,
        &harness.ctx(),
        &inputs(&[("scene", put_scene(&harness, &other))]),
    )
    .unwrap();
    assert_eq!(blind["weights"], outputs["weights"]);
}

#[test]
fn a_fixed_fit_is_the_base_configuration_whatever_the_scene() {
    let harness = Harness::default();
    let metrics = json(
        &harness,
        &trained(&harness, json!({"steps": 1, "fit": "fixed", "field": {}})),
        "metrics",
    );
    let levels = metrics["field"]["levels"].as_array().unwrap();
    assert_eq!(
        (levels.len(), &levels[15]["resolution"], &levels[15]["entries"]),
        (16, &json!(2048), &json!(1 << 19))
    );
    // 12.2 million in the tables and 10,240 weights (nerf.md, section 4).
    assert!(
        metrics["field"]["parameters"].as_u64().unwrap() > 12_000_000,
        "{}",
        metrics["field"]["parameters"]
    );
    assert_eq!(metrics["field"]["sizes"]["levels"]["reason"], "`levels` says so");
}

fn failure(harness: &Harness, scene: &marf_scene::Scene, more: Value) -> StageError {
    let train: Train = stage(table(&more));
    run(
        &train,
        &harness.ctx(),
        &inputs(&[("scene", put_scene(harness, scene))]),
    )
    .unwrap_err()
}

#[test]
fn a_scene_that_cannot_be_trained_is_refused_with_the_number() {
    let harness = Harness::default();
    let mut all_held_out = scene(&harness, 4);
    all_held_out
        .frames
        .iter_mut()
        .for_each(|frame| frame.held_out = true);
    let mut foreign = scene(&harness, 4);
    foreign.frames[1].camera.width = 48;
    let mut damaged = scene(&harness, 4);
    damaged.frames[3].image = harness.put(b"no picture");
    for (scene, more, start) in [
        (
            &marf_scene::Scene::default(),
            json!({}),
            "no photo to train on: 0 photos",
        ),
        (&all_held_out, json!({}), "no photo to train on: 4 photos"),
        (
            &foreign,
            json!({}),
            "photo `001` has 24 x 18 pixels, its camera is for 48 x 18",
        ),
        (&damaged, json!({}), "photo `003`: not a JPEG"),
        (
            &scene(&harness, 4),
            json!({"scale": 20}),
            "photo `002` of 24 x 18 pixels vanishes at `scale` 20",
        ),
    ] {
        let error = failure(&harness, scene, more).to_string();
        assert!(error.starts_with(start), "{error}");
    }
}

/// Versions and backends of these are in the key of the node that asks for them.
#[test]
fn children_are_named_with_the_device_they_will_have() {
    let device = json!("gpu:a100");
    let random = json!({"search": "random", "trials": 2, "scale": 1, "device": device});
    let tune: Tune = stage(random);
    let bootstrap: Bootstrap = stage(json!({"b": 2, "device": device}));
    let nodes: [(&dyn Expand, &str); 2] = [(&tune, "train"), (&bootstrap, "train")];
    let harness = Harness::default();
    for (node, child) in nodes {
        let children = node.children();
        let named: Vec<(&str, &Value)> = children
            .iter()
            .map(|child| (child.stage, &child.params["device"]))
            .collect();
        assert_eq!(named, [(child, &device)]);
        let asked = node.expand(&harness.ctx(), &inputs(&[])).unwrap();
        for asked in asked {
            assert_eq!((asked.stage.as_str(), &asked.params["device"]), (child, &device));
        }
    }
    let halving: Tune = stage(json!({"trials": 2, "scale": 1, "device": device}));
    let children = halving.children();
    let named = children.iter().map(|child| child.stage);
    assert_eq!(named.collect::<Vec<_>>(), ["train", "partial"]);
    assert_eq!(children[1].params["train"]["device"], device);
    let scene = inputs(&[("scene", harness.put(b"not read"))]);
    for asked in halving.expand(&harness.ctx(), &scene).unwrap() {
        assert_eq!(
            (asked.stage.as_str(), &asked.params["train"]["device"]),
            ("partial", &device)
        );
    }
}

fn downstream(harness: &Harness) -> marf_stage::Inputs {
    let trained = trained(harness, json!({}));
    inputs(&[
        ("weights", trained["weights"]),
        ("scene", trained["scene"]),
        ("metrics", trained["metrics"]),
    ])
}

#[test]
fn evaluate_agrees_with_train_and_knows_the_other_photos_too() {
    let harness = Harness::default();
    let inputs = downstream(&harness);
    let trained = json(&harness, &inputs.0, "metrics");
    let held_out: Evaluate = stage(json!({}));
    let held_out = json(
        &harness,
        &run(&held_out, &harness.ctx(), &inputs).unwrap(),
        "metrics",
    );
    assert_eq!(
        (&held_out["psnr"], &held_out["views"]),
        (&trained["psnr"], &trained["views"])
    );
    let all: Evaluate = stage(json!({"views": "all", "scale": 2}));
    let all = json(&harness, &run(&all, &harness.ctx(), &inputs).unwrap(), "metrics");
    assert_eq!(
        (all["views"].as_array().unwrap().len(), &all["scale"]),
        (12, &json!(2))
    );
}

/// If a digest changes and the stage's VERSION does not, raise the version.
#[test]
fn the_answers_belong_to_the_versions() {
    let harness = Harness::default();
    let inputs = downstream(&harness);
    let digest = |outputs: &Outputs| Digest::from_content(&serde_json::to_vec(outputs).unwrap()).short();
    let evaluate: Evaluate = stage(json!({"views": "all", "device": "cpu"}));
    let render: Render =
        stage(json!({"frames": 2, "width": 24, "outputs": ["rgb", "depth"], "device": "cpu"}));
    let found = [
        (
            "train",
            Train::VERSION,
            digest(&trained(&harness, json!({"device": "cpu"}))),
        ),
        (
            "evaluate",
            Evaluate::VERSION,
            digest(&run(&evaluate, &harness.ctx(), &inputs).unwrap()),
        ),
        (
            "render",
            Render::VERSION,
            digest(&run(&render, &harness.ctx(), &inputs).unwrap()),
        ),
    ];
    let found = found
        .each_ref()
        .map(|(name, version, digest)| (*name, *version, digest.as_str()));
    assert_eq!(
        found,
        [
            ("train", 25, "e7b9ef6539f5"),
            ("evaluate", 6, "7b90545a05fa"),
            ("render", 8, "aeaf49f3cc34")
        ]
    );
}

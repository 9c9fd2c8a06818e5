//! A scene of few photos is judged on all of them, each by a field that was trained without its place.

use crate::common::{inputs, json, put_scene, run, scene, small, stage};
use marf_scene::{Scene, folds};
use marf_stage::{Expand, Inputs, Outputs, harness::Harness};
use marf_train::{Evaluate, Folds, Train};
use serde_json::{Value, json};

/// A training of `scene` and what `folds` reads of it.
fn delivered(harness: &Harness, scene: &Scene) -> (Outputs, Inputs) {
    let digest = put_scene(harness, scene);
    let train: Train = stage(json!({"steps": 32, "field": small()}));
    let outputs = run(&train, &harness.ctx(), &inputs(&[("scene", digest)])).unwrap();
    let of = inputs(&[("scene", digest), ("setup", outputs["setup"])]);
    (outputs, of)
}

fn ids(views: &Value) -> Vec<String> {
    let id = |view: &Value| view["id"].as_str().unwrap().to_owned();
    views.as_array().unwrap().iter().map(id).collect()
}

#[test]
fn every_photo_is_judged_once_by_a_field_that_has_not_seen_its_place() {
    let harness = Harness::default();
    let scene = scene(&harness, 12);
    let (whole, of) = delivered(&harness, &scene);
    let judge: Folds = stage(json!({"folds": 3, "share": 0.5}));
    let nodes = judge.expand(&harness.ctx(), &of).unwrap();
    assert_eq!(nodes.len(), 3);
    let trained: Vec<Outputs> = nodes
        .into_iter()
        .map(|node| {
            assert_eq!(node.inputs, of);
            run(&stage::<Train>(node.params), &harness.ctx(), &node.inputs).unwrap()
        })
        .collect();
    let photos: Vec<_> = scene.frames.iter().map(Into::into).collect();
    let fold_of = folds(&photos, &scene.points, 3);
    let whole = json(&harness, &whole, "metrics");
    for (fold, outputs) in trained.iter().enumerate() {
        let metrics = json(&harness, outputs, "metrics");
        let expected: Vec<String> = (0..12)
            .filter(|photo| fold_of[*photo] as usize == fold)
            .map(|photo: usize| scene.frames[photo].id.clone())
            .collect();
        assert_eq!(ids(&metrics["views"]), expected);
        assert_eq!(metrics["train_photos"], 12 - expected.len());
        assert_eq!(metrics["drawn"].as_array().unwrap().len(), 12 - expected.len());
        assert_eq!(metrics["steps"], 16);
        assert_eq!(
            metrics["config"]["steps"], 16,
            "step size and length of steps follow"
        );
        assert_eq!(metrics["field"]["sizes"], whole["field"]["sizes"]);
        assert!(metrics.get("on_training").is_none());
        assert!(metrics["views"][0]["nearest"]["id"].as_str() != metrics["views"][0]["id"].as_str());
    }
    let outputs = judge.reduce(&harness.ctx(), &of, &trained).unwrap();
    let judged = json(&harness, &outputs, "metrics")["judged"].clone();
    let all: Vec<String> = scene.frames.iter().map(|frame| frame.id.clone()).collect();
    assert_eq!(ids(&judged["views"]), all);
    assert_eq!(
        (&judged["steps"], &judged["steps_of_whole"]),
        (&json!(16), &json!(32))
    );
    let mean = |of: &Value| {
        of.as_array()
            .unwrap()
            .iter()
            .map(|one| one["psnr"].as_f64().unwrap())
            .sum::<f64>()
    };
    assert!((judged["psnr"].as_f64().unwrap() - mean(&judged["views"]) / 12.0).abs() < 1e-9);
    assert_eq!(judged["folds"].as_array().unwrap().len(), 3);
    let pictures = outputs.keys().filter(|name| name.starts_with("heldout/")).count();
    assert_eq!(pictures, 12);
}

#[test]
fn enough_photos_or_a_single_place_train_nothing_and_say_so() {
    let harness = Harness::default();
    let (_, of) = delivered(&harness, &scene(&harness, 12));
    let judge: Folds = stage(json!({"below": 12}));
    assert!(judge.expand(&harness.ctx(), &of).unwrap().is_empty());
    let outputs = judge.reduce(&harness.ctx(), &of, &[]).unwrap();
    let metrics = json(&harness, &outputs, "metrics");
    assert_eq!((&metrics["photos"], &metrics["below"]), (&json!(12), &json!(12)));
    assert!(metrics.get("judged").is_none());

    // Of two photos in one place there are two folds: a place has at most half of the photos. One photo has none.
    let mut two = scene(&harness, 2);
    two.frames[1].cam_from_world = two.frames[0].cam_from_world;
    let mut at = of.clone();
    for (scene, expected) in [
        (two.clone(), 2),
        (
            Scene {
                frames: two.frames[..1].to_vec(),
                ..two
            },
            0,
        ),
    ] {
        at.0.insert("scene".to_owned(), put_scene(&harness, &scene));
        let judge: Folds = stage(json!({}));
        assert_eq!(judge.expand(&harness.ctx(), &at).unwrap().len(), expected);
    }
}

/// `evaluate` of a fold compares with the photos that the fold holds out, whatever `calibrate` holds out.
#[test]
fn the_evaluation_of_a_fold_takes_the_photos_it_has_not_seen() {
    let harness = Harness::default();
    let (_, of) = delivered(&harness, &scene(&harness, 12));
    let fold: Train = stage(json!({"fold": {"index": 1, "count": 3, "share": 0.25}}));
    let trained = run(&fold, &harness.ctx(), &of).unwrap();
    let mut of_field = inputs(&[("scene", of.0["scene"])]);
    for output in ["weights", "metrics"] {
        of_field.0.insert(output.to_owned(), trained[output]);
    }
    let evaluated = run(&stage::<Evaluate>(json!({})), &harness.ctx(), &of_field).unwrap();
    let [own, other] = [&trained, &evaluated].map(|outputs| json(&harness, outputs, "metrics"));
    assert_eq!(own["views"], other["views"]);
}

#[test]
fn a_training_tells_how_well_it_reproduces_photos_it_has_seen() {
    let harness = Harness::default();
    let (outputs, of) = delivered(&harness, &scene(&harness, 12));
    let metrics = json(&harness, &outputs, "metrics");
    assert_eq!(metrics["on_training"]["photos"], 3, "as many as are held out");
    let mut of_field = inputs(&[("scene", of.0["scene"])]);
    for output in ["weights", "metrics"] {
        of_field.0.insert(output.to_owned(), outputs[output]);
    }
    let all: Evaluate = stage(json!({"views": "train"}));
    let all = json(
        &harness,
        &run(&all, &harness.ctx(), &of_field).unwrap(),
        "metrics",
    );
    // Of nine photos the second, fifth and eighth.
    let three = [1, 4, 7].map(|index: usize| all["views"][index]["psnr"].as_f64().unwrap());
    let mean = three.iter().sum::<f64>() / 3.0;
    assert!((metrics["on_training"]["psnr"].as_f64().unwrap() - mean).abs() < 1e-9);
}

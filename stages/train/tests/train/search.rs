//! A search by halving with real trainings: it finds out of a wrong default, and its last rung is the training of one piece.

use std::collections::BTreeMap;

use crate::common::{inputs, json, put_scene, run, scene, small, stage};
use marf_cache::Digest;
use marf_stage::{Expand, Outputs, harness::Harness};
use marf_train::{Partial, Train, Tune};
use serde_json::{Value, json};

/// Runs a search round by round, as the engine does. Returns its outputs, and those of its nodes by name.
fn searched(harness: &Harness, scene: Digest, table: Value) -> (Outputs, BTreeMap<String, Outputs>) {
    let (tune, inputs): (Tune, _) = (stage(table), inputs(&[("scene", scene)]));
    let ctx = harness.ctx();
    let (mut done, mut named) = (Vec::new(), BTreeMap::new());
    let mut round = tune.expand(&ctx, &inputs).unwrap();
    while !round.is_empty() {
        for node in round {
            let outputs = match node.stage.as_str() {
                "partial" => run(&stage::<Partial>(node.params), &ctx, &node.inputs),
                _ => run(&stage::<Train>(node.params), &ctx, &node.inputs),
            };
            let outputs = outputs.unwrap();
            assert!(named.insert(node.name, outputs.clone()).is_none());
            done.push(outputs);
        }
        round = tune.further(&ctx, &inputs, &done).unwrap();
    }
    (tune.reduce(&ctx, &inputs, &done).unwrap(), named)
}

#[test]
fn a_default_rate_that_is_far_too_low_is_found_out() {
    let harness = Harness::default();
    let scene = put_scene(&harness, &scene(&harness, 12));
    let mut field = small();
    field["learning_rate"] = json!(0.0002);
    let table = json!({
        "trials": 4, "steps": 144, "field": field, "device": "cpu",
        "space": {"learning_rate": {"log": [0.005, 0.05]}},
    });
    let (outputs, nodes) = searched(&harness, scene, table);
    let scatter = json(&harness, &outputs, "scatter");
    let chosen = scatter["chosen"].as_u64().unwrap();
    assert!(chosen > 0, "{scatter}");
    let decision = scatter["decision"].as_str().unwrap();
    assert!(
        decision.contains("is chosen: +") && decision.contains("in the mean of two seeds"),
        "{decision}"
    );

    let params = json(&harness, &outputs, "params")["field"].clone();
    assert!(params["learning_rate"].as_f64().unwrap() >= 0.005, "{params}");
    assert_eq!(
        params["log2_table"], 11,
        "the base is part of what is chosen: {params}"
    );
    // The last rung went on from the states of two before it: in one piece it is the same training.
    let whole = json!({
        "steps": 144, "holdout": "validation", "scale": 1, "field": params, "device": "cpu",
    });
    let whole = run(
        &stage::<Train>(whole),
        &harness.ctx(),
        &inputs(&[("scene", scene)]),
    )
    .unwrap();
    assert_eq!(nodes[&format!("trial-{chosen:02}")], whole);
    // Photos that the scene holds out judge what was chosen without them.
    let psnr = |field: &Value| {
        let train: Train = stage(json!({"steps": 144, "field": field, "device": "cpu"}));
        let outputs = run(&train, &harness.ctx(), &inputs(&[("scene", scene)])).unwrap();
        json(&harness, &outputs, "metrics")["psnr"].as_f64().unwrap()
    };
    let (tuned, wrong) = (psnr(&params), psnr(&field));
    assert!(tuned > wrong + 0.1, "{tuned} dB against {wrong}");
}

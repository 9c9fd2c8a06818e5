//! A training that is stopped on its way and gone on with is the training that is not.

use crate::common::{inputs, json, put_scene, run, scene, small, stage};
use marf_cache::Digest;
use marf_stage::{Outputs, StageError, harness::Harness};
use marf_train::{Partial, Train};
use serde_json::{Value, json};

/// Steps of the whole training.
const STEPS: u64 = 96;

/// A training whose box is fitted to the field after 32 steps.
fn table() -> Value {
    let mut field = small();
    for (key, value) in [("refit_steps", json!(32)), ("background", json!("black"))] {
        field[key] = value;
    }
    json!({"steps": STEPS, "holdout": "validation", "field": field, "device": "cpu"})
}

struct Tried {
    harness: Harness,
    scene: Digest,
}

impl Tried {
    fn new() -> Self {
        let harness = Harness::default();
        let scene = put_scene(&harness, &scene(&harness, 12));
        Self { harness, scene }
    }

    fn partial(&self, until: u64, from: Option<Digest>, train: Value) -> Result<Outputs, StageError> {
        let stage: Partial = stage(json!({"until": until, "judged_px": 12, "train": train}));
        run(&stage, &self.harness.ctx(), &self.inputs(from))
    }

    fn train(&self, from: Option<Digest>, train: Value) -> Result<Outputs, StageError> {
        run(&stage::<Train>(train), &self.harness.ctx(), &self.inputs(from))
    }

    fn inputs(&self, from: Option<Digest>) -> marf_stage::Inputs {
        let mut inputs = inputs(&[("scene", self.scene)]);
        inputs.0.extend(from.map(|state| ("state".to_owned(), state)));
        inputs
    }
}

#[test]
fn in_pieces_it_gives_the_field_the_curve_and_the_metrics_of_one_piece() {
    let tried = Tried::new();
    let whole = tried.train(None, table()).unwrap();
    // Before the box is fitted, at that step, after it, and at the end.
    for stops in [vec![16], vec![32], vec![16, 48], vec![16, 32, 80], vec![STEPS]] {
        let mut state = None;
        for until in &stops {
            let outputs = tried.partial(*until, state, table()).unwrap();
            let reached = json(&tried.harness, &outputs, "reached");
            assert_eq!(
                (&reached["until"], &reached["steps"], &reached["held_out_photos"]),
                (&json!(until), &json!(STEPS), &json!(1))
            );
            assert!(reached["psnr"].as_f64().unwrap() > 5.0, "{reached}");
            state = Some(outputs["state"]);
        }
        assert_eq!(
            tried.train(state, table()).unwrap(),
            whole,
            "stopped after {stops:?} steps"
        );
    }
    // The schedule is that of the whole training: a short one of 16 steps learns something else.
    let short = tried
        .train(None, json!({"steps": 16, "field": table()["field"]}))
        .unwrap();
    assert_ne!(short["weights"], whole["weights"]);
}

#[test]
fn a_state_of_another_training_is_refused_and_what_differs_is_named() {
    let tried = Tried::new();
    let state = Some(tried.partial(32, None, table()).unwrap()["state"]);
    let with = |key: &str, value: Value| {
        let mut table = table();
        table[key] = value;
        table
    };
    for (train, word) in [
        (with("seed", json!(1)), "seed differs"),
        (with("steps", json!(112)), "config differs"),
        (with("scale", json!(2)), "photos, cameras or box differs"),
        (with("holdout", json!("test")), "number of views differs"),
    ] {
        let error = tried.train(state, train).unwrap_err().to_string();
        let begin = "the input `state` cannot be gone on from: ";
        assert!(
            error.starts_with(begin) && error.contains(word),
            "{word}: {error}"
        );
    }
    let error = tried.partial(16, state, table()).unwrap_err().to_string();
    assert_eq!(
        error,
        "the input `state` is of step 32, behind `until`, which is 16"
    );
    for bytes in [&b""[..], b"no state", &[0; 64]] {
        let state = Some(tried.harness.put(bytes));
        let error = tried.train(state, table()).unwrap_err().to_string();
        assert!(error.contains("cannot be gone on from"), "{bytes:?}: {error}");
    }
}

#[test]
fn the_device_of_the_training_is_in_no_key() {
    let params = |device: &str| {
        let mut train = table();
        train["device"] = json!(device);
        let stage: Partial = stage(json!({"until": 16, "train": train}));
        marf_stage::Stage::params(&stage)
    };
    assert_eq!(params("cpu"), params("auto"));
    assert_eq!(params("cpu")["train"]["steps"], STEPS);
}

/// If this digest changes and `Partial::VERSION` does not, raise the version.
#[test]
fn the_answer_belongs_to_the_version() {
    let tried = Tried::new();
    let outputs = tried.partial(16, None, table()).unwrap();
    let all = Digest::from_content(&serde_json::to_vec(&outputs).unwrap());
    assert_eq!(
        (<Partial as marf_stage::Define>::VERSION, all.short().as_str()),
        (17, "6b85ad43f0a8"),
        "{outputs:?}"
    );
}

//! Every long stage of this crate, stopped anywhere and continued: the same bytes, and nothing is done twice.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};

use crate::common::{self, inputs, put_scene, run, scene, scene_of, small, stage};
use marf_cache::Digest;
use marf_schema::train::TrainParams;
use marf_stage::{
    BlobError, Blobs, Cancel, Checkpoints, Ctx, Expand, Inputs, Keep, Outputs, StageError, harness::Harness,
};
use marf_train::{Bootstrap, Evaluate, Render, Train};
use serde_json::{Value, json};

/// Counts how often each blob is stored.
struct Counted<'a> {
    harness: &'a Harness,
    puts: Mutex<BTreeMap<Digest, u64>>,
}

impl<'a> Counted<'a> {
    fn new(harness: &'a Harness) -> Self {
        Self {
            harness,
            puts: Mutex::default(),
        }
    }
}

impl Blobs for Counted<'_> {
    fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, BlobError> {
        Blobs::get(self.harness, digest)
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        let digest = Blobs::put(self.harness, bytes)?;
        *self.puts.lock().unwrap().entry(digest).or_default() += 1;
        Ok(digest)
    }

    fn put_file(&self, path: &Path, max_bytes: u64, keep: Keep) -> Result<(Digest, Arc<[u8]>), BlobError> {
        self.harness.put_file(path, max_bytes, keep)
    }

    fn contains(&self, digest: &Digest) -> bool {
        self.harness.contains(digest)
    }

    fn commit(&self) -> Result<(), BlobError> {
        self.harness.commit()
    }
}

/// What a node does with a context.
type Work<'a> = &'a dyn Fn(&Ctx<'_>) -> Result<Outputs, StageError>;

/// Runs with a request to stop after `checks` questions for it.
fn run_for(blobs: &Counted<'_>, checks: u64, work: Work<'_>) -> Result<Outputs, StageError> {
    let cancel = Cancel::after(checks);
    work(&Ctx {
        blobs,
        cancel: &cancel,
        ..blobs.harness.ctx()
    })
}

/// Stops the work after every `stride` checks and continues it. Returns the outputs and the number of stops.
fn in_pieces(blobs: &Counted<'_>, stride: u64, work: Work<'_>) -> (Outputs, u64) {
    for stops in 0.. {
        match run_for(blobs, stride, work) {
            Ok(outputs) => return (outputs, stops),
            Err(StageError::Cancelled) => assert!(stops < 2_000, "no progress in pieces of {stride}"),
            Err(error) => panic!("{error}"),
        }
    }
    unreachable!("the loop returns")
}

/// A node on inputs of its own harness.
type Node = Box<dyn Fn(&Ctx<'_>) -> Result<Outputs, StageError>>;

/// Asserts that a node has the same outputs when it is stopped once anywhere, after every `step`-th check. Returns the number of checks
/// without a stop.
///
/// `fresh` stores the inputs in a new harness and returns the work on them.
fn same_when_stopped_once(step: usize, fresh: &dyn Fn(&Harness) -> Node) -> u64 {
    let whole = Harness::default();
    let expected = fresh(&whole)(&whole.ctx()).unwrap();
    for checks in (0..).step_by(step) {
        let harness = Harness::default();
        let work = fresh(&harness);
        match run_for(&Counted::new(&harness), checks, &work) {
            Err(StageError::Cancelled) => {}
            Err(error) => panic!("after {checks}: {error}"),
            Ok(outputs) => {
                assert_eq!(outputs, expected);
                return checks;
            }
        }
        let resumed = work(&harness.ctx()).unwrap();
        assert_eq!(resumed, expected, "stopped after {checks} checks");
    }
    unreachable!("the loop returns")
}

/// As [`same_when_stopped_once`], also when it is stopped again and again after `stride` checks. At most `overhead` of these may pass
/// before it continues from where it was, and no picture is stored twice.
fn same_when_stopped(step: usize, stride: u64, overhead: u64, fresh: &dyn Fn(&Harness) -> Node) {
    let questions = same_when_stopped_once(step, fresh);
    let whole = Harness::default();
    let work = fresh(&whole);
    let once = Counted::new(&whole);
    let expected = run_for(&once, u64::MAX - 1, &work).unwrap();
    let harness = Harness::default();
    let work = fresh(&harness);
    let blobs = Counted::new(&harness);
    let (outputs, stops) = in_pieces(&blobs, stride, &work);
    assert_eq!(outputs, expected, "in {stops} pieces of {stride} checks");
    assert!(
        stops > 1 && stops * (stride - overhead) <= questions,
        "{stops} stops after {stride} questions each, {questions} are enough without a stop"
    );
    for (name, digest) in outputs.iter().filter(|(name, _)| name.ends_with(".png")) {
        let puts = |blobs: &Counted<'_>| blobs.puts.lock().unwrap().get(digest).copied();
        assert_eq!(puts(&blobs), puts(&once), "{name}");
    }
}

fn training(harness: &Harness, more: Value) -> Node {
    let inputs = inputs(&[("scene", put_scene(harness, &scene(harness, 12)))]);
    let mut table = json!({"steps": 24, "field": small()});
    table
        .as_object_mut()
        .unwrap()
        .extend(more.as_object().unwrap().clone());
    let train: Train = stage(table);
    Box::new(move |ctx| run(&train, ctx, &inputs))
}

#[test]
fn a_training_and_its_judging_go_on_to_the_same_bytes_wherever_it_was_stopped() {
    same_when_stopped(17, 40, 28, &|harness| training(harness, json!({"steps": 48})));
}

#[test]
fn a_checkpoint_of_another_seed_or_of_other_steps_is_not_taken() {
    let expected = {
        let harness = Harness::default();
        training(&harness, json!({"seed": 2}))(&harness.ctx()).unwrap()
    };
    for other in [json!({"seed": 1}), json!({"seed": 2, "steps": 25})] {
        let harness = Harness::default();
        training(&harness, other)(&harness.ctx()).unwrap();
        let found = training(&harness, json!({"seed": 2}))(&harness.ctx()).unwrap();
        assert_eq!(found, expected);
    }
}

#[test]
fn damaged_checkpoints_cost_only_time() {
    let whole = Harness::default();
    let expected = training(&whole, json!({"steps": 60}))(&whole.ctx()).unwrap();
    for checks in [25, 50, 85] {
        for damage in [0, 1, 2] {
            let harness = Harness::default();
            let work = training(&harness, json!({"steps": 60}));
            let stopped = run_for(&Counted::new(&harness), checks, &work);
            assert!(stopped.is_err(), "{checks}");
            for part in ["training", "trained", "judging-0"] {
                let Some(mut state) = Checkpoints::load(&harness, part) else {
                    continue;
                };
                match damage {
                    0 => state.truncate(state.len() / 2),
                    1 => state.clear(),
                    _ => state.truncate(state.len() - 1),
                }
                Checkpoints::save(&harness, part, &state);
            }
            let resumed = work(&harness.ctx()).unwrap();
            assert_eq!(resumed, expected, "{checks} checks, damage {damage}");
        }
    }
}

/// The clock decides where it stops. The schedule of the whole run gives the same bytes without a stop.
#[test]
fn a_budget_is_trained_on_from_where_it_was_stopped() {
    for checks in [1, 4, 40, 150] {
        let harness = Harness::default();
        let inputs = inputs(&[("scene", put_scene(&harness, &scene(&harness, 8)))]);
        let table = json!({"budget": "600ms", "field": small()});
        let train: Train = stage(table.clone());
        let cancel = Cancel::after(checks);
        let stopped = run(
            &train,
            &Ctx {
                cancel: &cancel,
                ..harness.ctx()
            },
            &inputs,
        );
        // On a busy machine it may have ended before it was stopped so late.
        match stopped {
            Err(error) => assert!(matches!(error, StageError::Cancelled), "{checks}: {error}"),
            Ok(_) => assert!(checks > 4, "{checks}"),
        }
        let made = run(&train, &harness.ctx(), &inputs).unwrap();
        let params: TrainParams = serde_json::from_value(table).unwrap();
        let setup = serde_json::from_value(common::json(&harness, &made, "setup")).unwrap();
        let metrics = serde_json::from_value(common::json(&harness, &made, "metrics")).unwrap();
        let repeating: Train = stage(serde_json::to_value(params.repeating(&setup, &metrics)).unwrap());
        let fresh = Harness::default();
        put_scene(&fresh, &scene(&fresh, 8));
        assert_eq!(run(&repeating, &fresh.ctx(), &inputs).unwrap(), made, "{checks}");
    }
}

/// What `evaluate` and `render` read of a training.
fn trained(harness: &Harness, width: u32, height: u32) -> Inputs {
    let scene = put_scene(harness, &scene_of(harness, 12, width, height));
    let train: Train = stage(json!({"steps": 8, "field": small()}));
    let outputs = run(&train, &harness.ctx(), &inputs(&[("scene", scene)])).unwrap();
    inputs(&[
        ("weights", outputs["weights"]),
        ("scene", outputs["scene"]),
        ("metrics", outputs["metrics"]),
    ])
}

#[test]
fn an_evaluation_goes_on_to_the_same_bytes_wherever_it_was_stopped() {
    // Each piece begins with the depths of all photos that the field was trained on.
    same_when_stopped(5, 24, 14, &|harness| {
        let inputs = trained(harness, common::WIDTH, common::HEIGHT);
        let evaluate: Evaluate = stage(json!({"views": "all"}));
        Box::new(move |ctx| run(&evaluate, ctx, &inputs))
    });
}

#[test]
fn a_path_goes_on_to_the_same_bytes_wherever_it_was_stopped() {
    let path = |params: Value| {
        move |harness: &Harness| -> Node {
            let inputs = trained(harness, common::WIDTH, common::HEIGHT);
            let render: Render = stage(params.clone());
            Box::new(move |ctx| run(&render, ctx, &inputs))
        }
    };
    // Each picture asks once to be rendered, as one band, and once to be drawn.
    same_when_stopped(3, 5, 2, &path(json!({"frames": 6, "width": 24})));
    same_when_stopped_once(
        3,
        &path(json!({"frames": 3, "width": 24, "outputs": ["rgb", "depth"]})),
    );
}

/// Pictures of 512 x 384 pixels have three bands.
#[test]
fn a_large_picture_is_stopped_between_its_bands_and_kept_when_it_is_whole() {
    let harness = Harness::default();
    let inputs = trained(&harness, common::WIDTH, common::HEIGHT);
    let render: Render = stage(json!({"frames": 2, "width": 512}));
    let work = |ctx: &Ctx<'_>| run(&render, ctx, &inputs);
    let expected = work(&harness.ctx()).unwrap();
    let fresh = Harness::default();
    for digest in inputs.0.values() {
        fresh.put(&harness.get(digest).unwrap());
    }
    let counted = Counted::new(&fresh);
    // A question for each band: the second is the last to be rendered, then all three of the first picture.
    for bands in [2, 3] {
        let stopped = run_for(&counted, bands, &work);
        assert!(matches!(stopped, Err(StageError::Cancelled)), "{stopped:?}");
    }
    // The three bands of the second picture are left, then both are drawn.
    assert_eq!(run_for(&counted, 3 + 2, &work).unwrap(), expected);
}

#[test]
fn a_bootstrap_goes_on_to_the_same_bytes_wherever_it_was_stopped() {
    same_when_stopped(37, 40, 20, &|harness| {
        let scene = put_scene(harness, &scene(harness, 12));
        let inputs = inputs(&[("scene", scene)]);
        let member = |seed: u64| -> Outputs {
            let train: Train = stage(json!({"steps": 8, "seed": seed, "field": small()}));
            run(&train, &harness.ctx(), &inputs).unwrap()
        };
        let members = [member(0), member(1)];
        let bootstrap: Bootstrap = stage(json!({"b": 2}));
        let scene = inputs.clone();
        Box::new(move |ctx| bootstrap.reduce(ctx, &scene, &members))
    });
}

#[test]
fn pictures_that_were_lost_from_the_store_are_made_again() {
    let harness = Harness::default();
    let inputs = trained(&harness, common::WIDTH, common::HEIGHT);
    let evaluate: Evaluate = stage(json!({"views": "all"}));
    let work = |ctx: &Ctx<'_>| run(&evaluate, ctx, &inputs);
    let expected = work(&harness.ctx()).unwrap();
    let lost: Digest = expected["heldout/001.png"];
    harness.forget(&lost);
    assert_eq!(work(&harness.ctx()).unwrap(), expected);
    assert!(harness.get(&lost).is_some());
}

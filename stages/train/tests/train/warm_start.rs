//! A training that starts from the field of its node's last run, and the reasons for a cold start.

use std::sync::Mutex;
use std::time::Instant;

use crate::common::{inputs, json, put_scene, run, scene, small, stage};
use marf_cache::Digest;
use marf_field::{DepthSource, Field};
use marf_scene::Scene;
use marf_stage::{Cancel, Ctx, Expand, Outputs, Progress, Stage, StageError, harness::Harness};
use marf_train::{Bootstrap, Folds, Train};
use nalgebra::Vector3;
use serde_json::{Value, json};

/// Photos of the whole ring. Every fifth comes later.
const PHOTOS: u32 = 20;

fn table() -> Value {
    json!({"steps": 64, "warm_start": true, "field": small(), "device": "cpu"})
}

fn with(key: &str, value: Value) -> Value {
    let mut table = table();
    table[key] = value;
    table
}

/// A store, and a field of the first photos of a scene that grows.
struct Grown {
    harness: Harness,
    first: Scene,
    /// All photos. The earlier ones are unchanged.
    scene: Scene,
    earlier: Outputs,
}

impl Grown {
    fn new() -> Self {
        let harness = Harness::default();
        let scene = scene(&harness, PHOTOS);
        let frames = scene.frames.iter().enumerate();
        let frames = frames.filter(|(index, _)| index % 5 != 0);
        let first = Scene {
            frames: frames.map(|(_, frame)| frame.clone()).collect(),
            ..scene.clone()
        };
        let digest = put_scene(&harness, &first);
        let earlier = run(
            &stage::<Train>(table()),
            &harness.ctx(),
            &inputs(&[("scene", digest)]),
        )
        .unwrap();
        Self {
            harness,
            first,
            scene,
            earlier,
        }
    }

    /// Trains on a scene with weights of before, if any.
    fn train(&self, scene: &Scene, table: Value, earlier: Option<Digest>) -> Outputs {
        self.try_train(scene, table, earlier, &self.harness.ctx())
            .unwrap()
    }

    fn try_train(
        &self,
        scene: &Scene,
        table: Value,
        earlier: Option<Digest>,
        ctx: &Ctx<'_>,
    ) -> Result<Outputs, StageError> {
        let mut inputs = inputs(&[("scene", put_scene(&self.harness, scene))]);
        inputs
            .0
            .extend(earlier.map(|weights| ("earlier".to_owned(), weights)));
        run(&stage::<Train>(table), ctx, &inputs)
    }

    fn weights(&self) -> Option<Digest> {
        Some(self.earlier["weights"])
    }

    fn field(&self, outputs: &Outputs) -> Field {
        Field::decode(&self.harness.get(&outputs["weights"]).unwrap()).unwrap()
    }

    fn metrics(&self, outputs: &Outputs) -> Value {
        json(&self.harness, outputs, "metrics")
    }
}

/// Keeps the warnings.
#[derive(Default)]
struct Warnings(Mutex<Vec<String>>);

impl Progress for Warnings {
    fn at(&self, _done: u64, _total: u64, _note: &str) {}

    fn warn(&self, message: &str) {
        self.0.lock().unwrap().push(message.to_owned());
    }
}

#[test]
fn a_scene_that_has_grown_goes_on_from_its_field() {
    let grown = Grown::new();
    assert_eq!(
        grown.metrics(&grown.earlier)["warm_start"],
        json!({"cold": "this node has not finished before"})
    );
    let warm = grown.train(&grown.scene, table(), grown.weights());
    let told = json!({"from": grown.earlier["weights"]});
    assert_eq!(grown.metrics(&warm)["warm_start"], told);
    assert_eq!(json(&grown.harness, &warm, "setup")["warm_start"], told);
    let (before, now) = (grown.field(&grown.earlier), grown.field(&warm));
    assert_eq!((now.derived(), now.config()), (before.derived(), before.config()));
    assert_eq!(now.facts().steps, 64, "its own steps, not those of before");
    let photos = |field: &Field| field.learnt().unwrap().photos.len();
    assert_eq!((photos(&before), photos(&now)), (12, 15));

    // What pulls follows from the number of photos, which grows.
    let mut points = table();
    points["field"]["depth_source"] = json!("points");
    let warm = grown.train(&grown.scene, points, grown.weights());
    assert_eq!(grown.metrics(&warm)["warm_start"], told);
    assert_eq!(grown.field(&warm).config().depth_source, DepthSource::Points);

    // After few steps it still shows what it knew, which a training from nothing does not.
    let learnt = grown.train(&grown.first, with("steps", json!(400)), None)["weights"];
    let psnr = |earlier| {
        let outputs = grown.train(&grown.scene, with("steps", json!(8)), earlier);
        grown.metrics(&outputs)["on_training"]["psnr"].as_f64().unwrap()
    };
    let (warm, cold) = (psnr(Some(learnt)), psnr(None));
    assert!(warm > cold + 1.0, "{warm} dB, from nothing {cold} dB");
}

/// Each has a separate store, since the checkpoints of one would end the next.
#[test]
fn its_bytes_do_not_depend_on_threads_or_on_a_stop() {
    let train = |grown: &Grown| grown.train(&grown.scene, table(), grown.weights());
    let expected = train(&Grown::new());
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let found = pool.build().unwrap().install(|| train(&Grown::new()));
        assert_eq!(found, expected, "{threads} threads");
    }
    let (grown, mut stops) = (Grown::new(), 0);
    let found = (5..).step_by(10).find_map(|checks| {
        let cancel = Cancel::after(checks);
        let ctx = Ctx {
            cancel: &cancel,
            ..grown.harness.ctx()
        };
        match grown.try_train(&grown.scene, table(), grown.weights(), &ctx) {
            Ok(outputs) => Some(outputs),
            Err(StageError::Cancelled) => {
                stops += 1;
                None
            }
            Err(error) => panic!("{error}"),
        }
    });
    assert_eq!(found, Some(expected));
    assert!(stops > 1, "{stops}");
}

/// Each of these trains as if there were no earlier field, to the same bytes, and says why in outputs and warnings.
#[test]
fn what_does_not_fit_starts_anew_and_says_why() {
    let grown = Grown::new();
    let scene = |change: &dyn Fn(&mut Scene)| {
        let mut scene = grown.scene.clone();
        change(&mut scene);
        scene
    };
    let mute = grown.train(&grown.first, json!({"steps": 8, "field": small()}), None)["weights"];
    let moved = |scene: &mut Scene| {
        for frame in &mut scene.frames {
            frame.cam_from_world.translation += Vector3::new(0.1, 0.0, 0.0);
        }
    };
    let turned = |scene: &mut Scene| {
        let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), 0.02);
        for frame in &mut scene.frames {
            frame.cam_from_world.rotation *= turn.matrix();
        }
    };
    let far = |scene: &mut Scene| {
        let pose = &mut scene.frames[5].cam_from_world;
        pose.translation = -(pose.rotation * Vector3::new(40.0, 0.0, -2.0));
    };
    let held_out = |scene: &mut Scene| {
        scene.frames[1].held_out = true;
        scene.frames[8].held_out = true;
        scene.frames[2].held_out = false;
    };
    let few = |scene: &mut Scene| {
        scene
            .frames
            .retain(|frame| ["000", "001", "010"].contains(&frame.id.as_str()))
    };
    let mut other_field = small();
    other_field["density_width"] = json!(32);
    let mut rate = small();
    rate["learning_rate"] = json!(0.01);
    let cases: [(&str, Scene, Value, Digest); 11] = [
        (
            "photo `001` and 1 more, held out now",
            scene(&held_out),
            table(),
            grown.earlier["weights"],
        ),
        (
            "a unit of the scene is 2 m and was 1 m",
            scene(&|scene| scene.metres_per_unit = Some(2.0)),
            table(),
            grown.earlier["weights"],
        ),
        (
            "a unit of the scene is unknown",
            scene(&|scene| scene.metres_per_unit = None),
            table(),
            grown.earlier["weights"],
        ),
        (
            "from where they were",
            scene(&moved),
            table(),
            grown.earlier["weights"],
        ),
        (
            "from where they were",
            scene(&turned),
            table(),
            grown.earlier["weights"],
        ),
        (
            "of the 12 photos it was trained on 1 are in the scene",
            scene(&few),
            table(),
            grown.earlier["weights"],
        ),
        (
            "half sides of its box",
            scene(&far),
            table(),
            grown.earlier["weights"],
        ),
        (
            "`field.density_width` is 32 and was 16",
            grown.scene.clone(),
            with("field", other_field),
            grown.earlier["weights"],
        ),
        (
            "`field.learning_rate` is 0.01 and was 0.02",
            grown.scene.clone(),
            with("field", rate),
            grown.earlier["weights"],
        ),
        ("trained without `warm_start`", grown.scene.clone(), table(), mute),
        (
            "field",
            grown.scene.clone(),
            table(),
            grown.harness.put(b"no field"),
        ),
    ];
    for (word, scene, table, earlier) in cases {
        let warnings = Warnings::default();
        let ctx = Ctx {
            progress: &warnings,
            ..grown.harness.ctx()
        };
        let found = grown
            .try_train(&scene, table.clone(), Some(earlier), &ctx)
            .unwrap();
        let said = grown.metrics(&found)["warm_start"]["cold"]
            .as_str()
            .unwrap()
            .to_owned();
        assert!(said.contains(word), "{word}: {said}");
        assert_eq!(
            json(&grown.harness, &found, "setup")["warm_start"]["cold"],
            said.as_str()
        );
        let warnings = warnings.0.into_inner().unwrap();
        assert!(
            matches!(&warnings[..], [one] if one.contains(&said)),
            "{warnings:?}"
        );
        let cold = grown.train(&scene, table, None);
        assert_eq!(found["weights"], cold["weights"], "{said}");
    }
}

/// A photo that was trained on two runs ago and was not in the last scene is not forgotten.
#[test]
fn what_any_earlier_field_was_trained_on_is_remembered() {
    let grown = Grown::new();
    let mut without = grown.scene.clone();
    without.frames.retain(|frame| frame.id != "003");
    let second = grown.train(&without, table(), grown.weights());
    assert!(grown.metrics(&second)["warm_start"]["from"].is_string());
    let mut held_out = grown.scene.clone();
    held_out.frames[3].held_out = true;
    let third = grown.train(&held_out, table(), Some(second["weights"]));
    let said = grown.metrics(&third)["warm_start"]["cold"].to_string();
    assert!(said.contains("photo `003`, held out now"), "{said}");
}

#[test]
fn a_bootstrap_or_folds_of_it_are_refused_and_of_a_cold_one_are_not() {
    let grown = Grown::new();
    let warm = grown.train(&grown.scene, table(), grown.weights());
    let ctx = grown.harness.ctx();
    let scene = put_scene(&grown.harness, &grown.scene);
    let of = |outputs: &Outputs| inputs(&[("scene", scene), ("setup", outputs["setup"])]);
    let bootstrap: Bootstrap = stage(json!({"b": 2}));
    let folds: Folds = stage(json!({"folds": 2}));
    let member: Train = stage(json!({"seed": 1, "device": "cpu"}));
    for error in [
        bootstrap.expand(&ctx, &of(&warm)).unwrap_err(),
        folds.expand(&ctx, &of(&warm)).unwrap_err(),
        run(&member, &ctx, &of(&warm)).unwrap_err(),
    ] {
        let text = format!("{error:?}");
        assert!(
            text.contains("`warm_start`") && text.contains("set `warm_start = false`"),
            "{text}"
        );
    }
    assert_eq!(bootstrap.expand(&ctx, &of(&grown.earlier)).unwrap().len(), 2);
    run(&member, &ctx, &of(&grown.earlier)).unwrap();
}

#[test]
fn without_it_there_is_no_such_key_and_no_such_input() {
    let without: Train = stage(json!({"steps": 5}));
    assert!(!without.params().to_string().contains("warm_start"));
    assert_eq!(without.earlier(), None);
    let off: Train = stage(json!({"steps": 5, "warm_start": false}));
    assert_eq!(off.params(), without.params());
    let warm: Train = stage(json!({"steps": 5, "warm_start": true}));
    assert_eq!(
        (warm.earlier(), &warm.params()["warm_start"]),
        (Some("weights"), &json!(true))
    );
}

/// The field of a training by the clock is that of its schedule, from the same field.
#[test]
fn a_budget_goes_on_from_the_field_too_and_its_schedule_repeats_it() {
    let grown = Grown::new();
    let mut table = table();
    table.as_object_mut().unwrap().remove("steps");
    table["budget"] = json!("1s");
    let begun = Instant::now();
    let warm = grown.train(&grown.scene, table.clone(), grown.weights());
    assert!(begun.elapsed().as_secs() < 60);
    let setup = json(&grown.harness, &warm, "setup");
    assert_eq!(setup["warm_start"], json!({"from": grown.earlier["weights"]}));
    table.as_object_mut().unwrap().remove("budget");
    table["schedule"] = match &setup["schedule"] {
        Value::Null => json!([[0, setup["steps"]]]),
        schedule => schedule.clone(),
    };
    table["scale"] = setup["scale"].clone();
    let again = grown.train(&grown.scene, table, grown.weights());
    assert_eq!(again["weights"], warm["weights"]);
}

//! How long a training goes on, on which photos, and by which it is judged.

use crate::common::{HEIGHT, WIDTH, inputs, json, put_scene, run, scene, small, stage};
use marf_scene::Photo;
use marf_schema::train::TrainParams;
use marf_stage::{Outputs, harness::Harness};
use marf_train::{Evaluate, Train};
use serde_json::{Value, json};

/// The schedule that a budget made gives the same bytes without a clock.
#[test]
fn a_training_by_the_clock_is_repeated_by_its_schedule() {
    let harness = Harness::default();
    let scene = inputs(&[("scene", put_scene(&harness, &scene(&harness, 16)))]);
    let mut of_one_box = small();
    of_one_box["refit_steps"] = json!(0);
    for more in [
        json!({"budget": "500ms", "field": small()}),
        json!({"budget": "500ms"}),
        json!({"within": "1s", "seed": 3}),
        json!({"budget": "500ms", "target_psnr": 12.0}),
        json!({"budget": "500ms", "target_psnr": 70.0}),
    ] {
        let mut table = json!({"field": of_one_box});
        table
            .as_object_mut()
            .unwrap()
            .extend(more.as_object().unwrap().clone());
        let params: TrainParams = serde_json::from_value(table.clone()).unwrap();
        let clocked: Train = stage(table);
        assert!(params.limit().is_some());
        let made = run(&clocked, &harness.ctx(), &scene).unwrap();
        let setup = serde_json::from_value(json(&harness, &made, "setup")).unwrap();
        let metrics = serde_json::from_value(json(&harness, &made, "metrics")).unwrap();
        let repeating = params.repeating(&setup, &metrics).unwrap();
        assert_eq!(repeating.limit(), None);
        let plain: Train = stage(serde_json::to_value(repeating).unwrap());
        assert_eq!(made, run(&plain, &harness.ctx(), &scene).unwrap(), "{more}");
        // A member has the last box from its first step on.
        if more.get("field").is_some() {
            continue;
        }
        let setup_in = inputs(&[("scene", scene.0["scene"]), ("setup", made["setup"])]);
        let again = run(
            &stage::<Train>(json!({"seed": params.seed})),
            &harness.ctx(),
            &setup_in,
        )
        .unwrap();
        assert_eq!(again["weights"], made["weights"], "{more}");
    }
}

/// On a GPU the samples of a step follow its pace, too: they are among the parameters that repeat the bytes.
#[test]
fn a_training_by_the_clock_on_a_gpu_is_repeated_with_the_batch_of_its_pace() {
    let asked = std::env::var("MARF_TEST_GPU").unwrap_or("llvmpipe".to_owned());
    let device = format!("gpu:{asked}");
    let known: marf_field::Device = device.parse().unwrap();
    if !marf_field_gpu::backend_id(&known).is_some_and(|id| id.contains("wgpu")) {
        println!("skipped: needs a software adapter (mesa-vulkan-drivers)");
        return;
    }
    let harness = Harness::default();
    let scene = inputs(&[("scene", put_scene(&harness, &scene(&harness, 16)))]);
    let mut field = small();
    field.as_object_mut().unwrap().remove("batch_samples");
    let table = json!({"budget": "1s", "judged_photos": 1, "device": device, "field": field});
    let params: TrainParams = serde_json::from_value(table.clone()).unwrap();
    let made = run(&stage::<Train>(table), &harness.ctx(), &scene).unwrap();
    let setup = serde_json::from_value(json(&harness, &made, "setup")).unwrap();
    let metrics = serde_json::from_value(json(&harness, &made, "metrics")).unwrap();
    let repeating = params.repeating(&setup, &metrics).unwrap();
    let plain: Train = stage(serde_json::to_value(repeating).unwrap());
    assert_eq!(made, run(&plain, &harness.ctx(), &scene).unwrap());
}

/// The end is looked at, too, however short a training is. A wait that is over is an error, and nothing is trained.
#[test]
fn a_short_training_may_reach_its_target_and_no_time_is_an_error() {
    let harness = Harness::default();
    let scene = inputs(&[("scene", put_scene(&harness, &scene(&harness, 16)))]);
    let train: Train = stage(json!({"steps": 30, "field": small(), "target_psnr": 1.0}));
    let outputs = run(&train, &harness.ctx(), &scene).unwrap();
    let metrics = json(&harness, &outputs, "metrics");
    assert_eq!(metrics["target"]["reached_at"], 30);
    // Photos held back to watch the target are not trained on.
    let drawn = metrics["drawn"].as_array().unwrap();
    assert_eq!(metrics["train_photos"], drawn.len());
    let watching = metrics["target"]["validation_photos"].as_u64().unwrap();
    assert_eq!(drawn.len() as u64 + watching, 12);
    let judged = inputs(&[
        ("weights", outputs["weights"]),
        ("scene", outputs["scene"]),
        ("metrics", outputs["metrics"]),
    ]);
    let evaluate: Evaluate = stage(json!({"views": "all"}));
    let all = run(&evaluate, &harness.ctx(), &judged).unwrap();
    let all = json(&harness, &all, "metrics");
    // Only photos that were not trained on have a nearest one that was.
    let views = all["views"].as_array().unwrap().iter();
    let trained_on = views.filter(|view| view.get("nearest").is_none());
    assert!(trained_on.map(|view| &view["id"]).eq(drawn), "{drawn:?}: {all}");
    let late: Train = stage(json!({"within": "1ms", "field": small()}));
    let error = run(&late, &harness.ctx(), &scene).unwrap_err().to_string();
    assert!(
        error.starts_with("nothing of `within`, 0.001 s, is left"),
        "{error}"
    );
}

/// Of 15 photos held back, more than a look takes: all of them together decide.
#[test]
fn a_target_is_reached_where_all_photos_held_back_have_it() {
    let harness = Harness::default();
    let scene = inputs(&[("scene", put_scene(&harness, &scene(&harness, 160)))]);
    let trained = |psnr: f64| {
        let train: Train =
            stage(json!({"steps": 40, "field": small(), "target_psnr": psnr, "judged_photos": 1}));
        let outputs = run(&train, &harness.ctx(), &scene).unwrap();
        json(&harness, &outputs, "metrics")["target"].clone()
    };
    let missed = trained(80.0);
    assert_eq!(missed["validation_photos"], 15);
    let found = missed["validation_psnr"].as_f64().unwrap();
    for (psnr, reached_at) in [(found - 1e-6, json!(40)), (found + 1e-6, Value::Null)] {
        let target = trained(psnr);
        assert_eq!(
            (&target["reached_at"], target["validation_psnr"].as_f64()),
            (&reached_at, Some(found)),
            "{target}"
        );
    }
}

#[test]
fn a_target_stops_a_training_or_is_told_to_be_missed() {
    let harness = Harness::default();
    let scene = inputs(&[("scene", put_scene(&harness, &scene(&harness, 16)))]);
    let trained = |psnr: f64| {
        let train: Train = stage(json!({"steps": 1_200, "field": small(), "target_psnr": psnr}));
        let outputs = run(&train, &harness.ctx(), &scene).unwrap();
        json(&harness, &outputs, "metrics")
    };
    let (near, far) = (trained(14.0), trained(80.0));
    let target = &near["target"];
    let reached = target["reached_at"].as_u64().unwrap();
    assert!((256..1_200).contains(&reached), "{target}");
    assert_eq!(
        (near["steps"].as_u64(), &near["schedule"]),
        (Some(reached), &json!([[0, 1_200]]))
    );
    assert!(target["validation_psnr"].as_f64().unwrap() >= 14.0, "{target}");
    let target = &far["target"];
    assert_eq!(
        (far["steps"].as_u64(), &target["reached_at"]),
        (Some(1_200), &Value::Null)
    );
    assert!(target["forecast"]["psnr"].as_f64().unwrap() < 79.5, "{target}");
    assert!(target["forecast"]["at"].as_u64().unwrap() < 1_200, "{target}");
    let photos = |metrics: &Value| metrics["train_photos"].as_u64().unwrap();
    let whole: Train = stage(json!({"steps": 4, "field": small()}));
    let whole = json(&harness, &run(&whole, &harness.ctx(), &scene).unwrap(), "metrics");
    let held_back = target["validation_photos"].as_u64().unwrap();
    assert_eq!(photos(&far) + held_back, photos(&whole));
}

/// Twelve photos, three of them held out: 002, 006 and 010.
fn of_twelve(harness: &Harness, more: &Value) -> Outputs {
    let scene = put_scene(harness, &scene(harness, 12));
    let mut table = json!({"steps": 24, "field": small()});
    table
        .as_object_mut()
        .unwrap()
        .extend(more.as_object().unwrap().clone());
    run(
        &stage::<Train>(table),
        &harness.ctx(),
        &inputs(&[("scene", scene)]),
    )
    .unwrap()
}

/// What judges a field changes nothing of the field.
#[test]
fn some_photos_judge_as_they_do_among_all() {
    let harness = Harness::default();
    let all = of_twelve(&harness, &json!({}));
    let some = of_twelve(&harness, &json!({"judged_photos": 2}));
    assert_eq!(all["weights"], some["weights"]);
    let (all, some) = (json(&harness, &all, "metrics"), json(&harness, &some, "metrics"));
    let views = |metrics: &Value| metrics["views"].as_array().unwrap().clone();
    // 0 and 2 are the first of three whose bits are read backwards.
    assert_eq!(views(&some), [views(&all)[0].clone(), views(&all)[2].clone()]);
    assert_eq!(some["held_out_photos"], 3);
    assert!(all["on_training"].is_object() && some["on_training"].is_null());
    let more_than_all = json(
        &harness,
        &of_twelve(&harness, &json!({"judged_photos": 99})),
        "metrics",
    );
    assert_eq!(views(&more_than_all), views(&all));
}

/// A field trained on small photos is judged by those of a size that the user says, as `evaluate` judges it there.
#[test]
fn photos_of_another_size_judge_as_in_an_evaluation_of_that_size() {
    let harness = Harness::default();
    let large = of_twelve(&harness, &json!({"scale": 2, "judged_scale": 1}));
    let small = of_twelve(&harness, &json!({"scale": 2}));
    assert_eq!(large["weights"], small["weights"]);
    let metrics = json(&harness, &large, "metrics");
    assert_eq!(
        (&metrics["scale"], &metrics["judged_scale"]),
        (&json!(2), &json!(1))
    );
    assert_eq!(json(&harness, &small, "metrics")["judged_scale"], Value::Null);
    let picture = Photo::decode(&harness.get(&large["heldout/002.png"]).unwrap());
    let picture = picture.unwrap().image;
    assert_eq!((picture.width, picture.height), (WIDTH, HEIGHT));
    let trained = inputs(&[
        ("weights", small["weights"]),
        ("scene", small["scene"]),
        ("metrics", small["metrics"]),
    ]);
    let evaluated = run(&stage::<Evaluate>(json!({"scale": 1})), &harness.ctx(), &trained).unwrap();
    let evaluated = json(&harness, &evaluated, "metrics");
    assert_eq!(evaluated["views"], metrics["views"]);
}

/// Fewer photos are spread over all, are named, and are those of another training with this setup.
#[test]
fn fewer_photos_are_trained_on() {
    let harness = Harness::default();
    let few = of_twelve(&harness, &json!({"photos": 3}));
    let metrics = json(&harness, &few, "metrics");
    assert_eq!(metrics["drawn"], json!(["001", "005", "009"]));
    assert_eq!(
        (&metrics["train_photos"], &metrics["held_out_photos"]),
        (&json!(3), &json!(3))
    );
    let all = json(&harness, &of_twelve(&harness, &json!({"photos": 99})), "metrics");
    assert_eq!(all["train_photos"], 9);
    let setup = inputs(&[("scene", few["scene"]), ("setup", few["setup"])]);
    let again = run(&stage::<Train>(json!({})), &harness.ctx(), &setup).unwrap();
    assert_eq!(again["weights"], few["weights"]);
}

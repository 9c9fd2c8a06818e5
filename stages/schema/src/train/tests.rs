use super::*;
use marf_field::Derived;
use marf_stage::key_params;
use serde_json::json;

fn params(value: serde_json::Value) -> TrainParams {
    serde_json::from_value(value).unwrap()
}

#[test]
fn what_cannot_be_trained_is_refused_by_its_key() {
    for (value, path) in [
        (json!({"target_psnr": 0.0}), "target_psnr"),
        (json!({"target_psnr": 101}), "target_psnr"),
        (json!({"target_psnr": 28, "resample": 1}), "target_psnr"),
        (json!({"target_psnr": 28, "holdout": "validation"}), "target_psnr"),
        (json!({"steps": 0}), "steps"),
        (json!({"steps": 5, "budget": "60s"}), "budget"),
        (json!({"steps": 5, "schedule": [[0, 5]]}), "schedule"),
        (json!({"budget": "5s", "schedule": [[0, 5]]}), "schedule"),
        (json!({"budget": "5s", "within": "9s"}), "within"),
        (json!({"scale": 0}), "scale"),
        (json!({"judged_scale": 0}), "judged_scale"),
        (json!({"photos": 0}), "photos"),
        (json!({"judged_photos": 0}), "judged_photos"),
        (json!({"warm_start": true, "resample": 1}), "warm_start"),
        (
            json!({"warm_start": true, "fold": {"index": 0, "count": 2, "share": 1}}),
            "warm_start",
        ),
        (
            json!({"fold": {"index": 0, "count": 1, "share": 1}}),
            "fold.count",
        ),
        (
            json!({"fold": {"index": 3, "count": 3, "share": 1}}),
            "fold.index",
        ),
        (
            json!({"fold": {"index": 0, "count": 2, "share": 0}}),
            "fold.share",
        ),
        (
            json!({"fold": {"index": 0, "count": 2, "share": 1.5}}),
            "fold.share",
        ),
        (json!({"field": {"levls": 3}}), "field.levls"),
        (json!({"field": {"log2_table": 99}}), "field.log2_table"),
    ] {
        let error = params(value).check().unwrap_err();
        assert!(
            error.path == path || error.message.contains("log2_table"),
            "{path}: {error:?}"
        );
    }
    params(json!({"budget": "60s", "field": {"log2_table": 16}}))
        .check()
        .unwrap();
}

#[test]
fn a_training_with_a_budget_is_repeated_by_its_schedule() {
    let schedule: Schedule = serde_json::from_value(json!([[0, 900], [30, 700]])).unwrap();
    let setup = Setup {
        steps: 700,
        schedule: Some(schedule.clone()),
        watched: false,
        scale: 1,
        kept_every: 1,
        memory: Memory::default(),
        photos: None,
        holdout: Holdout::Test,
        fold: None,
        warm_start: None,
        fit: Fit::Scene,
        config: Config::default(),
        derived: Derived {
            origin: [0.0; 3],
            half_side: 1.0,
            depth: 1.0,
            box_reason: String::new(),
            sizes: crate::example::train_metrics().field.sizes,
        },
    };
    let budgeted = params(json!({"budget": "9s", "quality": "standard", "seed": 5, "target_psnr": 20}));
    let expected = json!({
        "schedule": [[0, 900], [30, 700]], "quality": "standard", "seed": 5, "target_psnr": 20,
        "scale": 1, "field": {"depth_source": "points"}
    });
    let metrics = crate::example::train_metrics();
    assert_eq!(budgeted.repeating(&setup, &metrics), Some(params(expected)));
    let within = params(json!({"within": "9s"}));
    let within = within.repeating(&setup, &metrics).unwrap();
    assert_eq!((within.limit(), within.planned_steps()), (None, 700));
    assert_eq!(within.judged_photos, Some(metrics.scores.views.len() as u64));
    assert_eq!(params(json!({"steps": 700})).repeating(&setup, &metrics), None);
    assert_eq!(params(json!({"schedule": [[0, 9], [3, 12]]})).planned_steps(), 12);
    assert_eq!(
        Setup {
            schedule: None,
            ..setup
        }
        .schedule(),
        Schedule::once(700)
    );
}

#[test]
fn a_training_has_drawn_the_photos_that_it_names_or_all() {
    let mut metrics = crate::example::train_metrics();
    metrics.drawn = None;
    assert!(metrics.has_drawn("a"));
    metrics.drawn = Some(vec!["a".to_owned(), "a".to_owned()]);
    assert_eq!(["a", "b"].map(|id| metrics.has_drawn(id)), [true, false]);
}

#[test]
fn a_fold_trains_its_share_of_the_steps_and_at_least_one() {
    let fold = |share| Fold {
        index: 0,
        count: 2,
        share,
    };
    assert_eq!(
        [1.0, 0.25, 1e-9].map(|share| fold(share).steps_of(1000)),
        [1000, 250, 1]
    );
    assert_eq!(fold(0.5).steps_of(0), 1);
}

#[test]
fn a_seed_of_64_bits_is_kept_whole() {
    let (high, low) = (
        params(json!({"seed": u64::MAX})),
        params(json!({"seed": u64::from(u32::MAX)})),
    );
    assert_eq!(high.seed, u64::MAX);
    assert_ne!(key_params(&high, &[]), key_params(&low, &[]));
    let text = serde_json::to_string(&high).unwrap();
    assert_eq!(serde_json::from_str::<TrainParams>(&text).unwrap(), high);
}

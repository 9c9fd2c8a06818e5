//! Every limit of a parameter: the value beyond it is refused with the sentence that names the limit, the one at it is taken.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use marf_scene::{Camera, Pose};
use marf_stage::ParamError;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use marf_schema::render::{PathKind, Place, RenderParams};
use marf_schema::{
    bootstrap::BootstrapParams, calibrate::CalibrateParams, changes::ChangesParams, depth::DepthParams,
    folds::FoldsParams, masks::MasksParams, partial::PartialParams, scenes::ScenesParams,
    surface::SurfaceParams, ties::TiesParams, train::TrainParams, tune::TuneParams, video::VideoParams,
};

type Check<P> = fn(&P) -> Result<(), ParamError>;

/// Checks that a table of parameters is refused with a sentence, and one like it is taken.
fn limit<P: DeserializeOwned>(check: Check<P>, refused: Value, said: &str, taken: Value) {
    let read = |value: &Value| serde_json::from_value::<P>(value.clone()).unwrap();
    let error = check(&read(&refused)).unwrap_err();
    assert_eq!(format!("{}: {}", error.path, error.message), said, "{refused}");
    assert_eq!(check(&read(&taken)), Ok(()), "{taken}");
}

#[test]
fn limits_of_trainings_are_those_that_their_sentences_name() {
    let train = |refused: Value, said: &str, taken: Value| limit(TrainParams::check, refused, said, taken);
    train(
        json!({"steps": 0}),
        "steps: 0 steps train nothing: use at least 1",
        json!({"steps": 1}),
    );
    train(
        json!({"scale": 0}),
        "scale: photos cannot be shrunk by 0: 1 keeps their size",
        json!({"scale": 1}),
    );
    train(
        json!({"judged_photos": 0}),
        "judged_photos: 0 photos measure nothing: use at least 1",
        json!({"judged_photos": 1}),
    );
    train(
        json!({"target_psnr": 0.0}),
        "target_psnr: 0 dB is not above 0 and at most 100",
        json!({"target_psnr": 0.1}),
    );
    train(
        json!({"target_psnr": 100.5}),
        "target_psnr: 100.5 dB is not above 0 and at most 100",
        json!({"target_psnr": 100.0}),
    );
    let fold = |index, count, share| json!({"fold": {"index": index, "count": count, "share": share}});
    train(
        fold(0, 1, 1.0),
        "fold.count: 1 folds hold out all or nothing: use at least 2",
        fold(0, 2, 1.0),
    );
    train(
        fold(2, 2, 1.0),
        "fold.index: fold 2 of 2, counted from 0",
        fold(1, 2, 1.0),
    );
    train(
        fold(0, 2, 1.5),
        "fold.share: 1.5 of the steps is not above 0 and at most 1",
        fold(0, 2, 0.001),
    );
    let partial =
        |refused: Value, said: &str, taken: Value| limit(PartialParams::check, refused, said, taken);
    partial(
        json!({"until": 0}),
        "until: 0 steps train nothing: use at least 16",
        json!({"until": 16}),
    );
    partial(
        json!({"until": 0, "train": {"steps": 5}}),
        "until: 0 steps train nothing: use at least 5",
        json!({"until": 5, "train": {"steps": 5}}),
    );
    partial(
        json!({"until": 40, "train": {"steps": 48}}),
        "until: 40 steps are not a multiple of 16: a training can only stop there",
        json!({"until": 32, "train": {"steps": 48}}),
    );
    partial(
        json!({"until": 16, "judged_px": 0}),
        "judged_px: 0 pixels show nothing: use at least 1",
        json!({"until": 16, "judged_px": 1}),
    );
    partial(
        json!({"until": 16, "train": {"warm_start": true}}),
        "train.warm_start: a training that is stopped on its way starts from scratch: only its own state is continued",
        json!({"until": 16}),
    );
    let folds = |refused: Value, said: &str, taken: Value| limit(FoldsParams::check, refused, said, taken);
    folds(
        json!({"folds": 1}),
        "folds: 1 folds hold out all or nothing: use at least 2",
        json!({"folds": 2}),
    );
    folds(
        json!({"share": 0.0}),
        "share: 0 of the steps is not above 0 and at most 1",
        json!({"share": 1.0}),
    );
}

#[test]
fn limits_of_searches_and_of_members_are_those_that_their_sentences_name() {
    let tune = |refused: Value, said: &str, taken: Value| limit(TuneParams::check, refused, said, taken);
    tune(
        json!({"trials": 1001}),
        "trials: 1001 is not within 1 to 1000",
        json!({"trials": 1000}),
    );
    tune(
        json!({"steps": 0}),
        "steps: 0 steps train nothing: use at least 1",
        json!({"steps": 1}),
    );
    tune(
        json!({"eta": 1}),
        "eta: 1 is not within 2 to 10",
        json!({"eta": 2}),
    );
    tune(
        json!({"eta": 11}),
        "eta: 11 is not within 2 to 10",
        json!({"eta": 10}),
    );
    tune(
        json!({"least_gain_db": 100.5}),
        "least_gain_db: 100.5 is not within 0 to 100",
        json!({"least_gain_db": 100}),
    );
    let space = |low: f64, high: f64| json!({"space": {"learning_rate": {"log": [low, high]}}});
    tune(
        space(0.01, 0.001),
        "space.learning_rate: `log = [0.01, 0.001]` must not fall, and be above 0 and finite",
        space(0.01, 0.01),
    );
    tune(
        space(0.0, 0.01),
        "space.learning_rate: `log = [0, 0.01]` must not fall, and be above 0 and finite",
        space(0.001, 0.01),
    );
    let bootstrap =
        |refused: Value, said: &str, taken: Value| limit(BootstrapParams::check, refused, said, taken);
    bootstrap(
        json!({"b": 1}),
        "b: 1 member has no spread: at least 2, 5 for maps, 10 for intervals",
        json!({"b": 2}),
    );
    bootstrap(
        json!({"b": 1001}),
        "b: 1001 is not within 2 to 1000",
        json!({"b": 1000}),
    );
    bootstrap(
        json!({"map_frames": 10_001}),
        "map_frames: 10001 is not within 1 to 10000",
        json!({"map_frames": 10_000}),
    );
    bootstrap(
        json!({"map_frames": 0}),
        "map_frames: 0 is not within 1 to 10000",
        json!({"map_frames": 1}),
    );
    bootstrap(
        json!({"viewpoints": []}),
        "viewpoints: the list is empty: name at least one kind",
        json!({"viewpoints": ["orbit"]}),
    );
}

#[test]
fn limits_of_pictures_are_those_that_their_sentences_name() {
    let render = |refused: Value, said: &str, taken: Value| limit(RenderParams::check, refused, said, taken);
    render(
        json!({"frames": 0}),
        "frames: 0 is not within 1 to 10000",
        json!({"frames": 1}),
    );
    render(
        json!({"frames": 10_001}),
        "frames: 10001 is not within 1 to 10000",
        json!({"frames": 10_000}),
    );
    render(
        json!({"width": 4097}),
        "width: 4097 is not within 1 to 4096",
        json!({"width": 4096}),
    );
    render(
        json!({"outputs": []}),
        "outputs: the list is empty: name at least one of `rgb`, `depth`, `uncertainty`",
        json!({"outputs": ["rgb", "depth", "uncertainty"]}),
    );
    render(
        json!({"path": "stills"}),
        "keyframes: the path `stills` needs one at the least",
        json!({"path": "orbit"}),
    );
    let place = |focal_px| Place {
        name: "north".to_owned(),
        camera: Camera::pinhole(64, 48, focal_px),
        cam_from_world: Pose::identity(),
    };
    let of = |path, keyframes| RenderParams {
        path,
        keyframes,
        ..RenderParams::default()
    };
    let said = |params: &RenderParams| params.check().unwrap_err().message;
    let two = vec![place(50.0), place(60.0)];
    assert_eq!(
        said(&of(PathKind::Orbit, vec![place(50.0)])),
        "the path `orbit` has none: take `keyframes` or `stills`"
    );
    assert_eq!(
        said(&of(PathKind::Keyframes, two.clone())),
        "number 2, `north`, has another field of view than the first: make stills of them, or give all the same"
    );
    assert_eq!(of(PathKind::Stills, two).check(), Ok(()));
    assert_eq!(of(PathKind::Keyframes, vec![place(50.0); 2]).check(), Ok(()));
    let many = of(PathKind::Stills, vec![place(50.0); 10_001]);
    assert_eq!(said(&many), "10001 are more than 10000");
    // The encoder may not be built in.
    let video = |key: &str, value: u32| {
        let params: VideoParams = serde_json::from_value(json!({key: value})).unwrap();
        params
            .check()
            .err()
            .map(|error| format!("{}: {}", error.path, error.message))
    };
    for (key, refused, said, taken) in [
        ("fps", 241, "fps: 241 is not within 1 to 240", 240),
        ("quantizer", 11, "quantizer: 11 is not within 12 to 51", 12),
    ] {
        assert_eq!(video(key, refused).as_deref(), Some(said));
        assert!(
            video(key, taken).is_none_or(|said| !said.starts_with(key)),
            "{key}"
        );
    }
}

#[test]
fn limits_of_scenes_and_surfaces_are_those_that_their_sentences_name() {
    let scenes = |refused: Value, said: &str, taken: Value| limit(ScenesParams::check, refused, said, taken);
    scenes(
        json!({"min_photos": 1}),
        "min_photos: 1 photos do not make a scene: use at least 2",
        json!({"min_photos": 2}),
    );
    scenes(
        json!({"min_photos": 9, "max_photos": 8}),
        "max_photos: 8 is less than `min_photos`, 9",
        json!({"min_photos": 9, "max_photos": 9}),
    );
    scenes(
        json!({"max_span_m": 0.0}),
        "max_span_m: a finite distance above 0 is needed",
        json!({"max_span_m": 0.1}),
    );
    limit(
        MasksParams::check,
        json!({"photos": 3}),
        "photos: 3 photos have too few pairs to detect what does not move: use at least 4",
        json!({"photos": 4}),
    );
    let ties = |refused: Value, said: &str, taken: Value| limit(TiesParams::check, refused, said, taken);
    ties(
        json!({"pairs": 0}),
        "pairs: 0 pairs of photos tie nothing, at least 1",
        json!({"pairs": 1}),
    );
    ties(
        json!({"min_points": 7}),
        "min_points: 7 points agree by chance, at least 8",
        json!({"min_points": 8}),
    );
    limit(
        CalibrateParams::check,
        json!({"extend": true, "method": "labels"}),
        "extend: only method = \"sfm\" goes on from an earlier scene",
        json!({"extend": true, "method": "sfm"}),
    );
    let surface =
        |refused: Value, said: &str, taken: Value| limit(SurfaceParams::check, refused, said, taken);
    surface(
        json!({"cell": 0.0}),
        "cell: 0 is not a finite length above 0",
        json!({"cell": 0.001}),
    );
    surface(
        json!({"least_photos": 0}),
        "least_photos: 0 would keep what no photo saw: use at least 1",
        json!({"least_photos": 1}),
    );
    for (refused, taken) in [(15, 16), (4097, 4096)] {
        let said = format!("side_px: {refused} is not within 16 to 4096");
        surface(json!({"side_px": refused}), &said, json!({"side_px": taken}));
    }
}

#[test]
fn limits_of_comparisons_are_those_that_their_sentences_name() {
    let with = |key: &str, value: Value| {
        let mut table = json!({"before": "1", "after": "2"});
        table[key] = value;
        table
    };
    for (key, refused, said, taken) in [
        ("b", json!(1), "b: 1 is not within 2 to 20", json!(2)),
        ("b", json!(21), "b: 21 is not within 2 to 20", json!(20)),
        (
            "steps",
            json!(0),
            "steps: 0 steps train nothing: use at least 1",
            json!(1),
        ),
        (
            "cell",
            json!(0.0),
            "cell: 0 is not a finite length above 0",
            json!(0.01),
        ),
        (
            "side_px",
            json!(15),
            "side_px: 15 is not within 16 to 4096",
            json!(16),
        ),
        (
            "sigmas",
            json!(0.9),
            "sigmas: 0.9 is below 1 or not finite: noise alone reaches 1",
            json!(1.0),
        ),
        (
            "least_cells",
            json!(0),
            "least_cells: a patch has at least 1 cell",
            json!(1),
        ),
        (
            "after",
            json!("latest"),
            "after: `latest` changes with every new sol: list the sols",
            json!("3"),
        ),
    ] {
        limit(ChangesParams::check, with(key, refused), said, with(key, taken));
    }
}

#[test]
fn limits_of_depths_are_those_that_their_sentences_name() {
    for (key, refused, said, taken) in [
        (
            "side_px",
            json!(63),
            "side_px: 63 is not within 64 to 8192",
            json!(64),
        ),
        (
            "side_px",
            json!(8193),
            "side_px: 8193 is not within 64 to 8192",
            json!(8192),
        ),
        (
            "neighbours",
            json!(0),
            "neighbours: 0 is not within 1 to 8",
            json!(1),
        ),
        (
            "neighbours",
            json!(9),
            "neighbours: 9 is not within 1 to 8",
            json!(8),
        ),
        (
            "map_cell",
            json!(-0.5),
            "map_cell: -0.5 is not a finite length above 0",
            json!(0.001),
        ),
    ] {
        limit(
            DepthParams::check,
            json!({key: refused}),
            said,
            json!({key: taken}),
        );
    }
}

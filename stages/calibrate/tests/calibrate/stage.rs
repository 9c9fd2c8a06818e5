//! The stage as the pipeline sees it: bad input, choices, and the version guard.

mod imported;

use marf_calibrate::Calibrate;
use marf_scene::{Cahvor, CameraPrior, EntrancePupil, Image, PhotoFacts, Pose, Srgb, encode_png};
use marf_stage::{Define, StageDef, StageError, define};
use nalgebra::Vector3;
use serde_json::json;

use crate::common::{Input, shared};
use imported::{imported, transforms};

/// A photo that is different everywhere.
fn picture(seed: u32) -> Vec<u8> {
    let image: Image<Srgb> = Image::from_fn(64, 48, |x, y| {
        [x * 4, y * 5, (x * y + seed * 40) % 256].map(|value| value as u8)
    });
    encode_png(&image).unwrap()
}

/// A lens whose every number is short. It looks along +x of its frame, z down.
fn lens() -> Cahvor {
    Cahvor {
        c: [0.5, 0.25, -2.0],
        a: [1.0, 0.0, 0.0],
        h: [32.0, 100.0, 0.0],
        v: [24.0, 0.0, 100.0],
        o: Some([0.8, 0.6, 0.0]),
        r: Some([0.0, 0.0, 0.0]),
        e: None,
    }
}

fn cahvor() -> Cahvor {
    Cahvor {
        o: Some([1.0, 0.0, 0.0]),
        r: Some([0.001, 0.25, 0.05]),
        ..lens()
    }
}

fn labelled(file: &str, model: Cahvor, site: i64, offset_m: f64) -> PhotoFacts {
    let site_from_rover = Pose {
        translation: Vector3::new(offset_m, 0.0, 0.0),
        ..Pose::identity()
    };
    PhotoFacts {
        file: file.to_owned(),
        width: 64,
        height: 48,
        prior: Some(CameraPrior {
            model,
            frame: "ROVER_NAV_FRAME".to_owned(),
            site_from_frame: Some(site_from_rover),
            motion_counter: vec![site, 10, 2],
        }),
        ..PhotoFacts::default()
    }
}

/// Three photos of site 3 (two need resampling), one of site 4, one whose label has no camera, one without.
fn mixed() -> Input {
    let mut input = Input::default();
    input.photo("A", &picture(1), labelled("a.jpg", cahvor(), 3, 10.0));
    input.photo("B", &picture(2), labelled("b.png", lens(), 3, 11.0));
    input.photo("C", &picture(3), labelled("c.jpg", cahvor(), 3, 14.0));
    input.photo("D", &picture(4), labelled("d.jpg", cahvor(), 4, 0.0));
    input.plain("e.png", &picture(5));
    let noted = PhotoFacts {
        file: "f.png".to_owned(),
        notes: vec!["label has no camera: CAHVORE without E".to_owned()],
        ..PhotoFacts::default()
    };
    input.photo("f", &picture(6), noted);
    input
}

#[test]
fn resampled_photos_are_the_same_wherever_the_run_was_stopped_and_are_not_resampled_again() {
    let params = json!({"method": "labels"});
    let expected = mixed().run_until(&params, u64::MAX - 1).unwrap();
    for checks in 0..200 {
        let input = mixed();
        let stopped = input.run_until(&params, checks);
        if let Ok(outputs) = stopped {
            // Two photos of some 45 rows, each with a question.
            assert!(checks >= 80 && outputs == expected, "{checks}");
            break;
        }
        assert!(matches!(stopped, Err(StageError::Cancelled)), "{checks}");
        assert_eq!(
            input.run_until(&params, u64::MAX - 1).unwrap(),
            expected,
            "{checks}"
        );
    }
    let input = mixed();
    let (first, again) = (
        input.run_until(&params, u64::MAX - 1),
        input.run_until(&params, 10),
    );
    assert_eq!((first.unwrap(), again.unwrap()), (expected.clone(), expected));
}

#[test]
fn labels_place_one_site_in_metres_and_say_why_of_the_others() {
    let output = mixed()
        .run(&json!({"method": "labels", "hold": "every", "hold_every": 2}))
        .unwrap();
    let ids: Vec<&str> = output
        .scene
        .frames
        .iter()
        .map(|frame| frame.id.as_str())
        .collect();
    assert_eq!(ids, ["A", "B", "C"]);
    let reasons: Vec<&str> = output
        .scene
        .unplaced
        .iter()
        .map(|one| one.reason.as_str())
        .collect();
    assert_eq!(
        reasons,
        [
            "of site 4, but this scene is of site 3 (`site = 4` builds it)",
            "no label",
            "label without camera (label has no camera: CAHVORE without E)",
        ]
    );
    // Centres at 10.5, 11.5 and 14.5 m north: the median is the origin.
    let north: Vec<f64> = output
        .scene
        .frames
        .iter()
        .map(|frame| frame.cam_from_world.centre().x)
        .collect();
    assert_eq!(north, [-1.0, 0.0, 3.0]);
    let site = output.scene.site.unwrap();
    assert_eq!((site.site, site.origin_m[0]), (3, 11.5));
    let tie = output.metrics.tie.unwrap();
    assert_eq!((tie.site, tie.photos), (3, 3));
    assert!(tie.largest_m < 1e-9, "{tie:?}");
    let frames = &output.scene.frames;
    assert_eq!(
        frames.iter().map(|frame| frame.held_out).collect::<Vec<_>>(),
        [true, false, true]
    );
    // An ideal pinhole keeps its bytes and its name. Half a pixel moves the principal point.
    let straight = &frames[1];
    assert_eq!(
        (straight.file.as_str(), straight.image),
        ("b.png", marf_cache::Digest::from_content(&picture(2)))
    );
    assert_eq!((straight.camera.cx_px, straight.camera.width), (32.5, 64));
    let resampled = &frames[0];
    assert_eq!(resampled.file, "a.png");
    assert!(
        resampled.camera.width < 64 && resampled.camera.cx_px.fract() == 0.0,
        "{:?}",
        resampled.camera
    );
    let photo = &output.metrics.photos[0];
    assert!(
        photo.registered && photo.held_out && photo.reason.is_empty(),
        "{photo:?}"
    );
}

#[test]
fn another_site_is_built_when_asked_for() {
    let params = json!({"method": "labels", "site": 4, "min_registered": 1, "hold_every": 0});
    let output = mixed().run(&params).unwrap();
    assert_eq!(output.scene.frames.len(), 1);
    assert_eq!(output.scene.frames[0].id, "D");
    let complaint = mixed().complaint(&json!({"method": "labels", "site": 9}));
    assert!(
        complaint.starts_with("0 of 6 photos were placed, and `min_registered` asks for 2"),
        "{complaint}"
    );
    assert!(
        complaint.contains("3 photos: of site 3") && complaint.contains("`site`"),
        "{complaint}"
    );
}

#[test]
fn a_bad_label_costs_one_photo_and_is_named() {
    let nan = Cahvor {
        c: [f64::MAX, f64::MAX, 0.0],
        a: [2.0, 0.0, 0.0],
        ..cahvor()
    };
    let folding = Cahvor {
        r: Some([0.0, -40.0, 0.0]),
        ..cahvor()
    };
    let lost = Cahvor {
        e: Some(EntrancePupil {
            terms: [0.0; 3],
            linearity: -1.0,
        }),
        r: Some([0.0, 0.1, 0.0]),
        h: [32.0, 20.0, 0.0],
        v: [24.0, 0.0, 20.0],
        ..cahvor()
    };
    for (model, part) in [
        (nan, "|A| is 2"),
        (folding, "no line of sight for pixel"),
        (lost, "no line of sight"),
    ] {
        let mut input = mixed();
        input.photo("G", &picture(7), labelled("g.jpg", model, 3, 12.0));
        let output = input.run(&json!({"method": "labels"})).unwrap();
        let reason = &output
            .scene
            .unplaced
            .iter()
            .find(|one| one.id == "G")
            .unwrap()
            .reason;
        assert!(reason.contains(part), "{reason}");
    }
    let mut input = mixed();
    let wrong_size = PhotoFacts {
        width: 32,
        height: 24,
        ..labelled("g.jpg", cahvor(), 3, 12.0)
    };
    input.photo("G", &picture(7), wrong_size);
    let output = input.run(&json!({"method": "labels"})).unwrap();
    let reason = &output
        .scene
        .unplaced
        .iter()
        .find(|one| one.id == "G")
        .unwrap()
        .reason;
    assert_eq!(
        reason,
        "label's camera is for 32 x 24 pixels, the photo has 64 x 48"
    );
}

#[test]
fn a_working_size_reduces_photo_and_camera_alike() {
    let full = mixed().run(&json!({"method": "labels"})).unwrap().scene;
    let input = mixed();
    let half = input
        .run(&json!({"method": "labels", "longest_side_px": 40}))
        .unwrap()
        .scene;
    for (full, half) in full.frames.iter().zip(&half.frames) {
        assert_eq!(half.camera, full.camera.box_reduced(2), "{}", full.id);
        let bytes = input.harness.get(&half.image).unwrap();
        let image = marf_scene::Photo::decode(&bytes).unwrap().image;
        assert_eq!(
            (image.width, image.height),
            (half.camera.width, half.camera.height)
        );
        assert!(half.file.ends_with(".png"), "{}", half.file);
    }
}

#[test]
fn no_photos_at_all_is_an_error_that_says_so() {
    for params in [
        json!({}),
        json!({"method": "labels"}),
        json!({"method": "import"}),
    ] {
        let complaint = Input::default().complaint(&params);
        assert!(complaint.starts_with("the set of photos is empty"), "{complaint}");
    }
}

#[test]
fn a_parameter_out_of_range_is_named() {
    let complain = |params: serde_json::Value| mixed().complaint(&params);
    let few = complain(json!({"max_features": 3}));
    assert!(few.contains("3 is too few, at least 64"), "{few}");
    assert!(complain(json!({"hold_every": 1})).contains("keep every photo from training"));
    assert!(complain(json!({"method": "labels", "extend": true})).contains("only method = \"sfm\""));
    assert!(complain(json!({"longest_side_px": 15})).contains("15 px are too few"));
    assert!(complain(json!({"metod": "labels"})).contains("unknown field `metod`"));
    let alone = complain(json!({"method": "labels", "min_registered": 1, "site": 4, "hold": "every"}));
    assert!(
        alone.contains("all 1 placed photos are kept from training"),
        "{alone}"
    );
}

#[test]
fn a_hostile_transforms_file_is_refused_by_its_field() {
    let Some(data) = shared("a_hostile_transforms_file_is_refused_by_its_field") else {
        return;
    };
    let cases = [
        (
            "tf_3x4.json",
            "`transforms.json` /frames/0: photo `a.jpg`: the camera is for 4 x 4 pixels, the photo has 64 x 48",
        ),
        (
            "tf_deep.json",
            "`transforms.json`: not JSON: recursion limit exceeded",
        ),
        (
            "tf_huge_wh.json",
            "`transforms.json` /w: 4294967295 is not a size",
        ),
        (
            "tf_nan.json",
            "`transforms.json` /fl_x: \"NaN\" is not a finite number",
        ),
        (
            "tf_singular.json",
            "`transforms.json` /frames/0/transform_matrix: the last row is [0.0, 0.0, 0.0, 0.0]",
        ),
        ("tf_traversal.json", "0 of 1 photos were placed"),
        (
            "tf_zero_focal.json",
            "`transforms.json` /fl_x: 0 is not a positive focal length",
        ),
    ];
    for (name, part) in cases {
        let mut input = Input::default();
        input.plain("a.jpg", &picture(1));
        input.companion(
            "transforms.json",
            &std::fs::read(data.join("bad-inputs/own").join(name)).unwrap(),
        );
        let complaint = input.complaint(&json!({"method": "import"}));
        assert!(complaint.starts_with(part), "{name}: {complaint}");
        let is_refused = part.starts_with('`');
        let hint = "correct the file or write it again: none of its cameras was used";
        assert!(!is_refused || complaint.contains(hint), "{name}: {complaint}");
    }
}

#[test]
fn the_answer_is_the_same_for_any_number_of_threads() {
    let digests: Vec<_> = [1, 2, 5]
        .into_iter()
        .map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| mixed().run(&json!({"method": "labels"})).unwrap().scene_digest)
        })
        .collect();
    assert!(digests.iter().all(|digest| *digest == digests[0]), "{digests:?}");
}

/// If this fails, `calibrate` answers differently: raise its VERSION, then put the new pair here.
#[test]
fn the_version_is_raised_when_the_answer_changes() {
    const STAGE: StageDef = define::<Calibrate>();
    assert_eq!((STAGE.version, STAGE.name), (Calibrate::VERSION, "calibrate"));
    let parts = |output: crate::common::Output| {
        let transforms = marf_cache::Digest::from_content(output.transforms.as_bytes());
        (output.scene_digest.short(), transforms.short())
    };
    let labels = parts(mixed().run(&json!({"method": "labels"})).unwrap());
    let import = imported(&["a.png", "b.png", "c.png"], &transforms(&["a", "b", "c"]));
    let import = parts(
        import
            .run(&json!({"method": "import", "longest_side_px": 32}))
            .unwrap(),
    );
    let text = |(scene, transforms): (String, String)| format!("{scene} {transforms}");
    let found = (Calibrate::VERSION, text(labels), text(import));
    assert_eq!(
        found,
        (
            16,
            "921e9d60702d 563ab5fcc1aa".to_owned(),
            "d6bc5b2d6f28 d8f0f8b2add1".to_owned()
        )
    );
}

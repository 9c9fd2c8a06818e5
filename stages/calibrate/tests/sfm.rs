//! Structure from motion on photos whose cameras are known: the demo's, and the rover mock-up's by COLMAP.
#![allow(clippy::unwrap_used, reason = "a fixture that is wrong should stop the test")]

mod common;
#[path = "common/judge.rs"]
mod judge;

use common::{Input, Output, folder, shared};
use judge::judge;
use marf_extract::{Extract, demo::Demo, demo::DemoOptions};
use marf_scene::{PhotoFacts, Pose};
use marf_stage::{Work, define};
use serde_json::json;

/// The good photos of the demo's first two sols, with their labels, and their true cameras.
fn demo() -> (Input, Vec<(String, Pose)>) {
    let options = DemoOptions::default();
    let demo = Demo::new(options.clone()).unwrap();
    let mut input = Input::default();
    let archive = json!({"archive": {"kind": "demo", "sols": "1..=2"}});
    let stage = (define::<Extract>().bind)(archive).unwrap();
    let Work::Source(source) = stage.work() else {
        panic!("extract is a source");
    };
    let mut truth = Vec::new();
    for sol in [1, 2] {
        for photo in demo.ground_truth(sol).unwrap().photos {
            // As calibrate resamples it: the pinhole along the lens's optical axis.
            let pinhole = photo
                .site_model
                .linearised(options.width_px, options.height_px)
                .unwrap();
            truth.push((photo.file, pinhole.cam_from_frame));
        }
        for row in source.fetch(&input.harness.ctx(), sol).unwrap().rows {
            let facts = PhotoFacts::from_json(&row.facts).unwrap();
            if truth.iter().any(|(file, _)| *file == facts.file) {
                let bytes = input.harness.get(&row.blobs["image"]).unwrap();
                input.photo(&row.id, &bytes, facts);
            }
        }
    }
    (input, truth)
}

#[test]
fn the_demo_is_brought_back_to_its_true_cameras_in_metres() {
    let (input, truth) = demo();
    let output = input.run(&json!({"method": "sfm"})).unwrap();
    let judged = judge(&output.scene, &truth);
    println!(
        "{judged:?} {} {:?}",
        output.scene.method, output.scene.frames[0].camera
    );
    println!("{:?}", output.metrics.totals);
    assert_eq!(judged.photos, truth.len());
    assert!(
        judged.rest_deg[0] <= 0.05 && judged.angle_deg[0] <= 0.05,
        "{judged:?}"
    );
    // The sun moves on from stop to stop, and shadow edges with it: the last stop leans by 0.08 degrees.
    assert!(judged.angle_deg[1] <= 0.1, "{judged:?}");
    assert!(judged.position[1] <= 0.001, "{judged:?}");
    assert!((judged.scale - 1.0).abs() <= 0.005, "{judged:?}");
    assert_eq!(
        (output.scene.metres_per_unit, output.scene.up),
        (Some(1.0), Some([0.0, 0.0, -1.0]))
    );
}

#[test]
fn a_label_that_is_wrong_is_outvoted_and_named() {
    let (mut input, truth) = demo();
    let wrong = input.turn_label(7, 5.0);
    let output = input.run(&json!({"method": "sfm"})).unwrap();
    let judged = judge(&output.scene, &truth);
    assert!(
        judged.position[0] <= 0.001 && (judged.scale - 1.0).abs() <= 0.005,
        "{judged:?}"
    );
    let named = output.metrics.photos.iter().filter(|photo| photo.note.is_some());
    let named: Vec<&str> = named.map(|photo| photo.id.as_str()).collect();
    assert_eq!(named, [wrong]);
}

/// The authors' cameras of the mock-up, by COLMAP.
fn mock_up() -> Option<(Input, Vec<(String, Pose)>)> {
    let data = shared("the mock-up's cameras")?.join("rover");
    let mut input = Input::default();
    folder(&mut input, &data, "images");
    let json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(data.join("transforms.json")).unwrap()).unwrap();
    let truth = json["frames"].as_array().unwrap().iter().map(|frame| {
        let file = frame["file_path"].as_str().unwrap().rsplit('/').next().unwrap();
        let rows: Vec<Vec<f64>> = serde_json::from_value(frame["transform_matrix"].clone()).unwrap();
        (format!("images/{file}"), from_opengl(&rows))
    });
    Some((input, truth.collect()))
}

fn from_opengl(rows: &[Vec<f64>]) -> Pose {
    let flip = [1.0, -1.0, -1.0];
    let world_from_cam = Pose {
        rotation: nalgebra::Matrix3::from_fn(|i, j| rows[i][j] * flip[j]),
        translation: nalgebra::Vector3::from_fn(|i, _| rows[i][3]),
    };
    world_from_cam.inverse()
}

fn calibrate_mock_up(threads: usize) -> Option<(Output, Vec<(String, Pose)>)> {
    let (input, truth) = mock_up()?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap();
    Some((
        pool.install(|| input.run(&json!({"method": "sfm"})).unwrap()),
        truth,
    ))
}

#[test]
fn the_mock_up_agrees_with_colmap_and_with_itself_for_any_threads() {
    let Some((output, truth)) = calibrate_mock_up(2) else {
        return;
    };
    let judged = judge(&output.scene, &truth);
    println!(
        "{judged:?} {} {:?}",
        output.scene.method, output.scene.frames[0].camera
    );
    println!("{:?}", output.metrics.totals);
    assert_eq!((judged.photos, output.scene.frames.len()), (92, 92));
    assert!(
        judged.position[0] <= 0.001 && judged.position[1] <= 0.005,
        "{judged:?}"
    );
    assert!(
        judged.rest_deg[0] <= 0.15 && judged.rest_deg[1] <= 0.5,
        "{judged:?}"
    );
    let focal_px = output.scene.frames[0].camera.fx_px;
    assert!((focal_px / 1453.3 - 1.0).abs() <= 0.005, "{focal_px}");
    assert!(output.metrics.totals.error_working_px.unwrap() <= 0.8);
    let apart = output
        .scene
        .unplaced
        .iter()
        .filter(|one| one.reason.contains("component 2"));
    assert_eq!(apart.count(), 6, "{:?}", output.scene.unplaced);
    let Some((again, _)) = calibrate_mock_up(5) else {
        return;
    };
    assert_eq!(output.scene_digest, again.scene_digest);
}

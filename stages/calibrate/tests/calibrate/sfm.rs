//! Structure from motion on photos whose cameras are known: the demo's, and the rover mock-up's by COLMAP.

mod errors;
mod intruders;
mod known;
mod rigs;
mod ties;

use std::sync::OnceLock;

use marf_calibrate::Calibrate;
use marf_demo::{Demo, DemoFile, DemoOptions};
use marf_pds::{ProductName, join_key, pds4};
use marf_scene::{Camera, Frame, Image, Photo, PhotoFacts, Pose, Srgb, encode_png};
use marf_stage::{Define, StageError};
use nalgebra::{Vector2, Vector3};
use serde_json::json;

use crate::common::{Input, Output, folder, shared};
use errors::errors_of;

/// A photo of the demo: id, image and facts.
type Taken = (String, Vec<u8>, PhotoFacts);
/// Photos with their labels, and their true cameras.
type Known = (Vec<Taken>, Vec<(String, Pose)>);

/// Options of a demo with small photos.
fn small() -> DemoOptions {
    DemoOptions {
        width_px: 480,
        height_px: 360,
        ..DemoOptions::default()
    }
}

/// The good photos of the demo's first two sols, drawn once.
fn drawn() -> &'static Known {
    static DRAWN: OnceLock<Known> = OnceLock::new();
    DRAWN.get_or_init(|| {
        let options = small();
        let demo = Demo::new(options.clone()).unwrap();
        let (mut taken, mut truth) = (Vec::new(), Vec::new());
        for sol in [1, 2] {
            let files = demo.files(sol, &|_, _| (), &|| false).unwrap();
            let photos = demo.ground_truth(sol).unwrap().photos;
            let mut of_sol: Vec<Taken> = photos.iter().map(|photo| labelled(&files, &photo.file)).collect();
            of_sol.sort_by_key(|(id, _, _)| join_key(id));
            taken.extend(of_sol);
            for photo in photos {
                // As calibrate resamples it: the pinhole along the lens's optical axis.
                let pinhole = photo
                    .site_model
                    .linearised(options.width_px, options.height_px)
                    .unwrap();
                truth.push((photo.file, pinhole.cam_from_frame));
            }
        }
        (taken, truth)
    })
}

/// A photo of the demo with the facts that its name and its label give, as `extract` reads them.
fn labelled(files: &[DemoFile], file: &str) -> Taken {
    let stem = file.rsplit_once('.').unwrap().0;
    let bytes = |name: &str| &files.iter().find(|one| one.name == name).unwrap().bytes;
    let name = ProductName::read(stem).unwrap();
    let label = pds4::read(bytes(&format!("{stem}.xml"))).unwrap();
    let photo = Photo::decode(bytes(file)).unwrap();
    let mut notes = photo.notes;
    let prior = label.fit_camera(Some(&name), photo.image.width, photo.image.height, &mut notes);
    notes.extend(label.notes);
    let facts = PhotoFacts {
        file: file.to_owned(),
        size_bytes: bytes(file).len() as u64,
        width: photo.image.width,
        height: photo.image.height,
        bands: photo.bands,
        sol: name.sol,
        instrument: Some(name.instrument),
        filter: name.filter,
        prior,
        notes,
        ..PhotoFacts::default()
    };
    (name.id, bytes(file).clone(), facts)
}

/// The photos, with nothing computed of them.
fn photographed() -> Input {
    let mut input = Input::default();
    for (id, bytes, facts) in &drawn().0 {
        input.photo(id, bytes, facts.clone());
    }
    input
}

/// The photos and what structure from motion makes of them, computed once.
fn solved() -> &'static (Input, Output) {
    static SOLVED: OnceLock<(Input, Output)> = OnceLock::new();
    SOLVED.get_or_init(|| {
        let input = photographed();
        let output = input.run(&json!({"method": "sfm"})).unwrap();
        (input, output)
    })
}

/// The photos, with the features and the matches that were computed once, and their true poses.
fn demo() -> (Input, Vec<(String, Pose)>) {
    (solved().0.clone(), drawn().1.clone())
}

#[test]
fn the_demo_is_brought_back_to_its_true_cameras_in_metres() {
    let (output, truth) = (&solved().1, &drawn().1);
    let errors = errors_of(&output.scene, truth);
    println!(
        "{errors:?} {} {:?}",
        output.scene.method, output.scene.frames[0].camera
    );
    println!("{:?}", output.metrics.totals);
    assert_eq!(errors.photos, truth.len());
    assert!(
        errors.rest_deg[0] <= 0.05 && errors.angle_deg[0] <= 0.1,
        "{errors:?}"
    );
    // The sun moves on from stop to stop, and shadow edges with it: the last stop leans by 0.12 degrees.
    assert!(errors.angle_deg[1] <= 0.15, "{errors:?}");
    assert!(errors.position[1] <= 0.001, "{errors:?}");
    assert!((errors.scale - 1.0).abs() <= 0.005, "{errors:?}");
    assert_eq!(
        (output.scene.metres_per_unit, output.scene.up),
        (Some(1.0), Some([0.0, 0.0, -1.0]))
    );
}

/// Labels are off by centimetres, so their site is, too. The tie of the world to it reports how far.
#[test]
fn the_world_lies_in_the_site_of_its_labels_and_stays_there_when_it_is_extended() {
    let (mut input, truth) = demo();
    let whole = &solved().1;
    let later = input.split_off(8);
    let few = input.run(&json!({"method": "sfm"})).unwrap();
    input.add(later);
    let params = json!({"method": "sfm", "extend": true});
    let extended = input.run_after(&params, Some(few.scene_digest)).unwrap();
    assert_eq!(extended.scene.site, few.scene.site);
    for (output, photos) in [(whole, truth.len()), (&extended, truth.len()), (&few, 8)] {
        let site = output.scene.site.unwrap();
        let tie = output.metrics.tie.unwrap();
        assert_eq!((site.site, tie.site, tie.photos), (1, 1, photos));
        assert!(
            0.0 < tie.median_m && tie.median_m <= tie.largest_m && tie.largest_m < 0.06,
            "{tie:?}"
        );
        for frame in &output.scene.frames {
            let (_, true_pose) = truth.iter().find(|(file, _)| frame.file == *file).unwrap();
            let centre = frame.cam_from_world.centre() + Vector3::from(site.origin_m);
            let off_m = (centre - true_pose.centre()).norm();
            assert!(off_m < 0.05, "{}: {off_m} m", frame.file);
        }
    }
}

/// If this fails, `sfm` answers differently: raise the stage's VERSION and that of the memo whose rows differ
/// (`sfm/photo_features.rs`, `sfm/compare.rs`), then put the new pair here. It must not fail on another machine.
#[test]
fn the_version_is_raised_when_structure_from_motion_answers_otherwise() {
    let found = (Calibrate::VERSION, solved().1.scene_digest.short());
    assert_eq!(found, (16, "20d148979ea2".to_owned()));
}

#[test]
fn a_label_that_is_wrong_is_outvoted_and_named() {
    let (mut input, truth) = demo();
    let wrong = input.turn_label(7, 5.0);
    let output = input.run(&json!({"method": "sfm"})).unwrap();
    let errors = errors_of(&output.scene, &truth);
    assert!(
        errors.position[0] <= 0.001 && (errors.scale - 1.0).abs() <= 0.005,
        "{errors:?}"
    );
    let named = output.metrics.photos.iter().filter(|photo| photo.note.is_some());
    let named: Vec<&str> = named.map(|photo| photo.id.as_str()).collect();
    assert_eq!(named, [wrong]);
    let mut notes = output
        .metrics
        .photos
        .iter()
        .filter_map(|photo| photo.note.as_deref());
    let note = notes.next().unwrap();
    let words: Vec<&str> = note.split(' ').collect();
    let [.., "photos:", metres, "m", "and", degrees, "degrees", "off"] = words[..] else {
        panic!("{note}")
    };
    // Turned by 5 degrees about the rover's origin, from which the mast stands about a metre away.
    let (metres, degrees): (f64, f64) = (metres.parse().unwrap(), degrees.parse().unwrap());
    assert!(
        note.starts_with("label outvoted by the photos: ") && metres < 0.15 && (degrees - 5.0).abs() < 0.5,
        "{note}"
    );
    let method = &output.scene.method;
    assert!(
        method.contains("in metres by the labels, 1 of them outvoted"),
        "{method}"
    );
}

#[test]
fn labels_that_contradict_the_photos_give_no_scale_and_that_is_said() {
    let (mut input, truth) = demo();
    for index in 0..truth.len() {
        input.turn_label(index, 30.0 * index as f64);
    }
    let output = input.run(&json!({"method": "sfm"})).unwrap();
    assert_eq!(output.scene.metres_per_unit, None);
    let said = &output.scene.method;
    assert!(
        said.starts_with("sfm: ") && said.contains(" lens, without scale: of 40 labels no half agrees"),
        "{said}"
    );
    assert!(errors_of(&output.scene, &truth).position[1] < 0.002);
}

#[test]
fn what_is_kept_of_photos_and_pairs_is_enough_to_solve_them_again() {
    let (input, _) = demo();
    let first = &solved().1;
    input.forget_photos();
    let again = input.run(&json!({"method": "sfm", "hold_every": 5})).unwrap();
    let poses = |output: &Output| -> Vec<Pose> {
        let frames = output.scene.frames.iter();
        frames.map(|frame| frame.cam_from_world).collect()
    };
    assert_eq!(poses(first), poses(&again));
    // Other features are not kept.
    let complaint = input.complaint(&json!({"method": "sfm", "max_features": 500}));
    assert!(complaint.contains("no blob"), "{complaint}");
}

#[test]
fn new_photos_join_the_earlier_scene_and_its_world_stays() {
    let (mut input, truth) = demo();
    let later = input.split_off(20);
    let earlier = input.run(&json!({"method": "sfm"})).unwrap();
    input.add(later);
    let params = json!({"method": "sfm", "extend": true});
    let output = input.run_after(&params, Some(earlier.scene_digest)).unwrap();
    assert_eq!((earlier.scene.frames.len(), output.scene.frames.len()), (20, 40));
    for old in &earlier.scene.frames {
        let now = output
            .scene
            .frames
            .iter()
            .find(|frame| frame.id == old.id)
            .unwrap();
        let moved = (now.cam_from_world.centre() - old.cam_from_world.centre()).norm();
        assert!(moved < 0.01, "{}: {moved} m", old.id);
        assert_eq!(now.held_out, old.held_out, "{}", old.id);
    }
    let held_out = |frames: &[Frame]| frames.iter().filter(|frame| frame.held_out).count();
    let (before, now) = (held_out(&earlier.scene.frames), held_out(&output.scene.frames));
    assert!(before > 0 && (before..=8).contains(&now), "{before}, then {now}");
    let errors = errors_of(&output.scene, &truth);
    assert!(
        errors.position[1] < 0.002 && (errors.scale - 1.0).abs() < 0.005,
        "{errors:?}"
    );
    assert_eq!(output.scene.metres_per_unit, Some(1.0));
}

/// The first photos of the demo, reduced for the scene.
fn few() -> Input {
    let mut input = photographed();
    input.split_off(8);
    input
}

/// Each photo is read once for its features and once to be reduced, in all runs together.
#[test]
fn a_calibration_goes_on_to_the_same_bytes_wherever_it_was_stopped() {
    let params = json!({"method": "sfm", "longest_side_px": 200});
    let expected = few().run_until(&params, u64::MAX - 1).unwrap();
    let (mut stops, input) = (0, few());
    // A photo that is resampled asks at each of its rows.
    let mut checks = 500;
    let found = loop {
        match input.run_until(&params, checks) {
            Ok(found) => break found,
            Err(StageError::Cancelled) => stops += 1,
            Err(error) => panic!("{error}"),
        }
        checks *= 2;
    };
    assert_eq!(found, expected);
    assert!(stops > 2, "{stops}");
    let reads: Vec<u64> = (input.photos().iter())
        .map(|photo| input.harness.reads(photo))
        .collect();
    // Photos that were being searched when the run was stopped are read again.
    let most = 2 * reads.len() as u64 + stops * rayon::current_num_threads() as u64;
    assert!(reads.iter().sum::<u64>() <= most, "{stops} {reads:?}");
}

/// Views of one photo by a camera that only turns: a panorama.
fn panorama(photo: &Image<Srgb>) -> Vec<Vec<u8>> {
    let (source, target) = (Camera::pinhole(480, 360, 492.0), Camera::pinhole(320, 240, 500.0));
    let view = |index: i32| {
        let angle = 0.04 * f64::from(index - 4);
        let ahead = Vector3::new(angle.sin(), 0.3 * angle, angle.cos());
        let cam_from_world = Pose::looking_at(Vector3::zeros(), ahead, Vector3::y());
        let image = Image::from_fn(320, 240, |x, y| {
            let ray = target
                .unproject(&Vector2::new(f64::from(x) + 0.5, f64::from(y) + 0.5))
                .unwrap();
            let pixel = source.project(&cam_from_world.inverse().direction(&ray)).unwrap();
            bilinear(photo, pixel.x - 0.5, pixel.y - 0.5)
        });
        encode_png(&image).unwrap()
    };
    (0..9).map(view).collect()
}

fn bilinear(photo: &Image<Srgb>, x: f64, y: f64) -> [u8; 3] {
    let (x, y) = (x.clamp(0.0, 478.0), y.clamp(0.0, 358.0));
    let (left, top) = (x as u32, y as u32);
    let (right, down) = (x - f64::from(left), y - f64::from(top));
    [0, 1, 2].map(|channel| {
        let at = |column: u32, row: u32| f64::from(photo.at(left + column, top + row)[channel]);
        let upper = at(0, 0) * (1.0 - right) + at(1, 0) * right;
        let lower = at(0, 1) * (1.0 - right) + at(1, 1) * right;
        (upper * (1.0 - down) + lower * down + 0.5) as u8
    })
}

#[test]
fn a_panorama_is_refused_with_that_word() {
    let photo = &drawn().0[0].1;
    let mut input = Input::default();
    for (index, view) in panorama(&Photo::decode(photo).unwrap().image).iter().enumerate() {
        input.plain(&format!("{index}.png"), view);
    }
    let complaint = input.complaint(&json!({"method": "sfm"}));
    assert!(complaint.starts_with("0 of 9 photos were placed"), "{complaint}");
    for word in ["panorama", "pure rotation", "parallax", "method = \"labels\""] {
        assert!(complaint.contains(word), "{word}: {complaint}");
    }
    assert!(
        !complaint.contains("did not drive"),
        "no label says so: {complaint}"
    );
    input.stand_still(&[3, 1_950, 0]);
    let complaint = input.complaint(&json!({"method": "sfm"}));
    assert!(
        complaint.contains("the rover did not drive: site, drive, pose [3, 1950, 0]"),
        "{complaint}"
    );
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

/// The output on the first photos of the mock-up, and its true poses.
fn calibrate_mock_up(photos: usize, threads: usize) -> Option<(Output, Vec<(String, Pose)>)> {
    let (mut input, truth) = mock_up()?;
    input.split_off(photos);
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
fn the_mock_up_agrees_with_colmap() {
    let Some((output, truth)) = calibrate_mock_up(98, 2) else {
        return;
    };
    let errors = errors_of(&output.scene, &truth);
    println!(
        "{errors:?} {} {:?}",
        output.scene.method, output.scene.frames[0].camera
    );
    println!("{:?}", output.metrics.totals);
    assert_eq!((errors.photos, output.scene.frames.len()), (92, 92));
    assert!(
        errors.position[0] <= 0.001 && errors.position[1] <= 0.005,
        "{errors:?}"
    );
    assert!(
        errors.rest_deg[0] <= 0.15 && errors.rest_deg[1] <= 0.5,
        "{errors:?}"
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
}

#[test]
fn the_mock_up_has_the_same_cameras_for_any_threads() {
    let [Some((two, _)), Some((five, _))] = [2, 5].map(|threads| calibrate_mock_up(24, threads)) else {
        return;
    };
    assert!(two.scene.frames.len() > 16, "{}", two.scene.method);
    assert_eq!(two.scene_digest, five.scene_digest);
}

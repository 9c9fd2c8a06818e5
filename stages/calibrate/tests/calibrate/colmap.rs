//! Method `colmap` with a script in COLMAP's place.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use marf_cache::Digest;
use marf_calibrate::{Tracks, write_colmap};
use marf_scene::{Camera, Frame, Image, PhotoFacts, Point, Pose, Scene, Srgb, encode_png};
use marf_stage::StageError;
use nalgebra::Vector3;
use serde_json::json;

use crate::common::{Input, Output};

/// A folder with a link to the script, by which it finds what it has to do.
struct Fake(tempfile::TempDir);

impl Fake {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fake/colmap");
        std::os::unix::fs::symlink(script, dir.path().join("colmap")).unwrap();
        Self(dir)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap()
    }

    fn params(&self) -> serde_json::Value {
        json!({"method": "colmap", "colmap": self.path("colmap"), "hold_every": 0})
    }

    /// A model of these photos for the mapper to write.
    fn model(&self, number: u32, files: &[&str]) {
        let folder = self.path("models").join(number.to_string());
        std::fs::create_dir_all(&folder).unwrap();
        for (name, bytes) in write_colmap(&scene(files), &Tracks::without_observations(&[point()])) {
            std::fs::write(folder.join(name), bytes).unwrap();
        }
    }
}

fn point() -> Point {
    Point {
        position: [0.5, 0.25, 7.0],
        color: Some([1, 2, 3]),
        views: 0,
    }
}

/// One camera that steps to the right from photo to photo.
fn scene(files: &[&str]) -> Scene {
    let frame = |(step, file): (usize, &&str)| Frame {
        id: (*file).to_owned(),
        file: (*file).to_owned(),
        image: Digest::from_content(file.as_bytes()),
        camera: Camera {
            k1: 0.1,
            k2: -0.05,
            ..Camera::pinhole(32, 24, 30.0)
        },
        cam_from_world: Pose {
            translation: Vector3::new(-(step as f64), 0.5, 2.0),
            ..Pose::identity()
        },
        held_out: false,
        mask: None,
        error_px: None,
    };
    Scene {
        frames: files.iter().enumerate().map(frame).collect(),
        ..Scene::default()
    }
}

fn picture(seed: u32) -> Vec<u8> {
    let picture = Image::<Srgb>::from_fn(32, 24, |x, y| [x * 7, y * 9, seed].map(|value| value as u8));
    encode_png(&picture).unwrap()
}

/// Four photos of two instruments, and a mask of one photo.
fn input() -> Input {
    let mut input = Input::default();
    for (seed, (file, instrument)) in [("b.png", "ZL"), ("a.png", "ZL"), ("c.png", "ZR"), ("d.png", "ZL")]
        .into_iter()
        .enumerate()
    {
        let facts = PhotoFacts {
            file: file.to_owned(),
            width: 32,
            height: 24,
            instrument: Some(instrument.to_owned()),
            ..PhotoFacts::default()
        };
        input.photo(file, &picture(seed as u32), facts);
    }
    input.companion("masks/b.png", &picture(9));
    input
}

fn ids(output: &Output) -> Vec<&str> {
    output
        .scene
        .frames
        .iter()
        .map(|frame| frame.id.as_str())
        .collect()
}

#[test]
fn the_largest_model_places_its_photos_and_the_others_are_listed() {
    let fake = Fake::new();
    fake.model(0, &["001/00002.png", "000/00003.png"]);
    fake.model(1, &["000/00000.png", "000/00001.png", "000/00003.png"]);
    let output = input().run(&fake.params()).unwrap();
    assert_eq!(ids(&output), ["a.png", "b.png", "d.png"]);
    let frame = &output.scene.frames[1];
    assert_eq!(frame.cam_from_world.translation, Vector3::new(-1.0, 0.5, 2.0));
    assert_eq!((frame.camera.fx_px, frame.camera.k2), (30.0, -0.05));
    assert_eq!(
        frame.image,
        Digest::from_content(&picture(0)),
        "the photo itself, not a copy"
    );
    assert_eq!(output.scene.points.len(), 1);
    assert_eq!(output.scene.unplaced[0].id, "c.png");
    assert_eq!(
        output.scene.unplaced[0].reason,
        "not in the largest of colmap's models, of 2"
    );
    assert_eq!(
        output.scene.method,
        "COLMAP 9.9: OPENCV cameras, exhaustive_matcher, largest model"
    );
    assert_eq!(output.scene.metres_per_unit, None);
}

#[test]
fn photos_of_one_camera_share_a_folder_and_masks_lie_under_their_names() {
    let fake = Fake::new();
    fake.model(0, &["000/00000.png", "000/00001.png"]);
    input().run(&fake.params()).unwrap();
    assert_eq!(
        fake.read("files"),
        "images/000/00000.png\nimages/000/00001.png\nimages/000/00003.png\nimages/001/00002.png\nmasks/000/00001.png.png\n"
    );
    let calls = fake.read("calls");
    let step = |name: &str| {
        calls
            .lines()
            .find(|line| line.starts_with(name) && !line.contains("--help"))
            .unwrap()
    };
    let features = step("feature_extractor");
    assert!(
        features.contains("--ImageReader.mask_path") && features.contains("single_camera_per_folder 1"),
        "{features}"
    );
    // Only options that the step's help names are given.
    assert!(
        features.ends_with("--SiftExtraction.use_gpu 0 --FeatureMatching.num_threads 1"),
        "{features}"
    );
}

#[test]
fn many_photos_are_matched_in_the_order_of_their_files() {
    let fake = Fake::new();
    fake.model(0, &["000/00000.png", "000/00060.png"]);
    let mut input = Input::default();
    (0..61).for_each(|number| input.plain(&format!("{number:02}.png"), &picture(number)));
    let output = input.run(&fake.params()).unwrap();
    assert_eq!(ids(&output), ["00.png", "60.png"]);
    assert!(
        output.scene.method.contains("sequential_matcher"),
        "{}",
        output.scene.method
    );
}

#[test]
fn a_failing_step_shows_its_last_lines() {
    let fake = Fake::new();
    std::fs::write(fake.path("fails"), "mapper").unwrap();
    let complaint = input().complaint(&fake.params());
    assert!(
        complaint.starts_with("`colmap mapper` failed: exit status: 3\nline 2\n"),
        "{complaint}"
    );
    assert!(complaint.contains("line 7"), "{complaint}");
}

#[test]
fn a_program_that_is_not_there_or_is_no_colmap_is_one_error_with_a_way_out() {
    for (program, part) in [
        ("/nowhere/colmap", "the program `/nowhere/colmap` is not there"),
        ("true", "`true` does not call itself COLMAP"),
    ] {
        let complaint = input().complaint(&json!({"method": "colmap", "colmap": program}));
        assert!(
            complaint.starts_with(part) && complaint.contains("install COLMAP"),
            "{complaint}"
        );
        assert!(complaint.contains("method = \"sfm\""), "{complaint}");
    }
}

#[test]
fn no_model_is_an_error() {
    let complaint = input().complaint(&Fake::new().params());
    assert!(complaint.starts_with("colmap placed no photo"), "{complaint}");
}

#[test]
fn a_wish_to_stop_kills_the_program() {
    let fake = Fake::new();
    std::fs::write(fake.path("waits"), "feature_extractor").unwrap();
    let input = input();
    let cancel = input.harness.cancel.clone();
    let pid = fake.path("pid");
    let stopped = std::thread::scope(|scope| {
        scope.spawn(move || {
            let deadline = Instant::now() + Duration::from_secs(20);
            while !pid.exists() && Instant::now() < deadline {
                std::thread::yield_now();
            }
            cancel.set();
        });
        input.run(&fake.params())
    });
    assert!(matches!(stopped, Err(StageError::Cancelled)), "{stopped:?}");
    let process = Path::new("/proc").join(fake.read("pid").trim());
    assert!(!process.exists(), "{} lives on", process.display());
}

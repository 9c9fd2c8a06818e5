//! The reduction on real fields: a wall photographed from one side, seen from there and from elsewhere.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

use marf_cache::Digest;
use marf_field::{Overrides, Trainer, View};
use marf_scene::{Camera, Frame, Image, Photo, Pose, Scene, Srgb, encode_png};
use marf_schema::{
    bootstrap::{BootstrapParams, Metrics},
    example,
    video::Film,
};
use marf_stage::{Define, Document, Expand, Inputs, Outputs, TypedOutputs, harness::Harness};
use marf_train::Bootstrap;
use nalgebra::Vector3;
use serde_json::json;

const WIDTH: u32 = 32;
const HEIGHT: u32 = 24;

/// Stripes of a wall in the plane y = 0; the cameras stand at y = -3.
fn photo(cam_from_world: &Pose) -> Image<Srgb> {
    let camera = Camera::pinhole(WIDTH, HEIGHT, 30.0);
    let world_from_cam = cam_from_world.inverse();
    Image::from_fn(WIDTH, HEIGHT, |column, row| {
        let pixel = nalgebra::Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let ray = world_from_cam.direction(&camera.unproject(&pixel).unwrap());
        let eye = cam_from_world.centre();
        let hit = eye - ray * (eye.y / ray.y);
        if (hit.x * 2.0).floor() as i64 % 2 == 0 {
            [210, 150, 90]
        } else {
            [70, 40, 30]
        }
    })
}

fn scene(harness: &Harness) -> Scene {
    let frame = |index: u32| {
        let eye = Vector3::new(f64::from(index) * 0.4 - 1.8, -3.0, f64::from(index % 3) * 0.3);
        let cam_from_world = Pose::looking_at(eye, Vector3::zeros(), Vector3::z());
        Frame {
            id: format!("{index:02}"),
            file: format!("{index:02}.png"),
            image: harness.put(&encode_png(&photo(&cam_from_world)).unwrap()),
            camera: Camera::pinhole(WIDTH, HEIGHT, 30.0),
            cam_from_world,
            held_out: index % 2 == 1,
            error_px: None,
        }
    };
    Scene {
        frames: (0..10).map(frame).collect(),
        up: Some([0.0, 0.0, -1.0]),
        ..Scene::default()
    }
}

/// What `train` leaves behind, from the field alone.
fn member(harness: &Harness, scene: &Scene, seed: u64) -> Outputs {
    let decode = |frame: &Frame| Photo::decode(&harness.get(&frame.image).unwrap()).unwrap().image;
    let (held_out, training): (Vec<_>, Vec<_>) = scene.frames.iter().partition(|frame| frame.held_out);
    let view = |frame: &&Frame| View {
        id: frame.id.clone(),
        camera: frame.camera,
        cam_from_world: frame.cam_from_world,
        image: decode(frame).into(),
    };
    let keys = json!({"levels": 4, "log2_table": 11, "finest_resolution": 64, "density_width": 16, "color_width": 16,
        "batch_samples": 2048, "occupancy_resolution": 32, "background": "black"});
    let config = serde_json::from_value::<Overrides>(keys)
        .unwrap()
        .over(&Default::default())
        .unwrap();
    let views = training.iter().map(view).collect();
    let mut trainer = Trainer::new(views, &[], &config, seed).unwrap();
    for _ in 0..80 {
        trainer.advance(1).unwrap();
    }
    let mut metrics = example::train_metrics();
    (metrics.seed, metrics.scores.ssim) = (seed, None);
    let photos = held_out
        .iter()
        .map(|frame| (format!("photo/{}.png", frame.id), frame.image));
    let mut outputs: Outputs = photos.collect();
    outputs.insert("weights".into(), harness.put(&trainer.field().unwrap().encode()));
    outputs.put(&harness.ctx(), &metrics).unwrap();
    outputs
}

struct Fixture {
    harness: Harness,
    inputs: Inputs,
    members: Vec<Outputs>,
}

fn fixture(count: u64) -> Fixture {
    let harness = Harness::default();
    let scene = scene(&harness);
    let members = (0..count).map(|seed| member(&harness, &scene, seed)).collect();
    let digest = harness.put(&scene.encode().unwrap());
    let inputs = Inputs([("scene".to_owned(), digest)].into());
    Fixture {
        harness,
        inputs,
        members,
    }
}

impl Fixture {
    fn reduce(&self, params: serde_json::Value) -> (Metrics, Outputs) {
        let params: BootstrapParams = serde_json::from_value(params).unwrap();
        let stage = Bootstrap::new(params).unwrap();
        let outputs = stage
            .reduce(&self.harness.ctx(), &self.inputs, &self.members)
            .unwrap();
        let metrics = self.harness.get(&outputs["metrics"]).unwrap();
        (Metrics::decode(&metrics).unwrap(), outputs)
    }
}

#[test]
fn photos_give_maps_figures_and_a_fly_through() {
    let fixture = fixture(3);
    let (report, outputs) = fixture.reduce(json!({"b": 3, "frames": 3, "width": 40}));
    let held_out = report.heldout.unwrap();
    assert!(
        held_out.mean.psnr > held_out.psnr_members_mean - 8.0,
        "{held_out:?}"
    );
    assert!((0.0..=1.0).contains(&held_out.coverage.sd2), "{held_out:?}");
    assert_eq!(held_out.calibration.unwrap().fit_photos, 3);
    assert!(
        report.std > report.std_paper && report.std_paper > 0.0,
        "{}",
        report.std
    );
    for kind in ["mean", "photo", "std", "opacity", "total", "depth-std", "error"] {
        assert!(
            outputs.contains_key(&format!("maps/03-{kind}.png")),
            "{kind}: {:?}",
            outputs.keys()
        );
    }
    for kind in ["std", "total", "depth-std", "rgb-std"] {
        let array = fixture
            .harness
            .get(&outputs[&format!("maps/03-{kind}.npy")])
            .unwrap();
        let channels = if kind == "rgb-std" { 3 } else { 1 };
        assert_eq!(
            array.len(),
            128 + 4 * channels * (WIDTH * HEIGHT) as usize,
            "{kind}"
        );
    }
    let film = fixture.harness.get(&outputs["film"]).unwrap();
    let names = ["0001", "0002", "0003"].map(|name| outputs[&format!("flythrough/{name}.png")]);
    assert_eq!(Film::decode(&film).unwrap().0, names);
    let sizes = names.map(|digest| {
        let picture = Photo::decode(&fixture.harness.get(&digest).unwrap())
            .unwrap()
            .image;
        (picture.width, picture.height)
    });
    assert!(
        sizes[0].0 >= 3 * 40 && sizes.iter().all(|size| *size == sizes[0]),
        "{sizes:?}"
    );
    keep(&fixture.harness, &outputs);
}

/// Writes the pictures for a person to look at, where the environment names a folder.
fn keep(harness: &Harness, outputs: &Outputs) {
    let Some(folder) = std::env::var_os("MARF_LOOK") else {
        return;
    };
    for (name, digest) in outputs {
        let path = std::path::Path::new(&folder).join(name.replace('/', "-"));
        std::fs::write(path, harness.get(digest).unwrap()).unwrap();
    }
}

#[test]
fn the_order_of_the_members_changes_only_their_own_rows() {
    let mut fixture = fixture(3);
    let params = json!({"b": 3, "frames": 2, "width": 24});
    let (_, before) = fixture.reduce(params.clone());
    fixture.members.rotate_left(1);
    let (_, after) = fixture.reduce(params);
    for (name, digest) in &before {
        assert_eq!(after[name] == *digest, name != "metrics", "{name}");
    }
}

#[test]
fn a_path_has_maps_without_photos() {
    let fixture = fixture(2);
    let (report, outputs) =
        fixture.reduce(json!({"b": 2, "frames": 1, "width": 20, "viewpoints": "orbit", "map_frames": 2}));
    assert_eq!((report.heldout, report.views.len()), (None, 2));
    assert!(outputs.contains_key("maps/0002-std.png") && !outputs.contains_key("maps/0002-photo.png"));
    assert!(outputs.contains_key("film") && outputs.contains_key("flythrough/0001.png"));
}

#[test]
fn a_member_without_weights_is_named() {
    let mut fixture = fixture(2);
    fixture.members[1].remove("weights");
    let stage = Bootstrap::new(BootstrapParams {
        b: 2,
        ..BootstrapParams::default()
    })
    .unwrap();
    let error = stage
        .reduce(&fixture.harness.ctx(), &fixture.inputs, &fixture.members)
        .unwrap_err();
    assert_eq!(error.to_string(), "member 01 has no output `weights`");
    fixture.members[1].insert("weights".into(), fixture.harness.put(b"junk"));
    let error = stage
        .reduce(&fixture.harness.ctx(), &fixture.inputs, &fixture.members)
        .unwrap_err();
    assert!(
        error.to_string().starts_with("member 01, output `weights`: "),
        "{error}"
    );
}

/// Three panels of 1280 x 3200: wider or higher than any video, which is found before a field is read.
#[test]
fn a_fly_through_that_no_video_can_hold_is_refused_before_it_is_rendered() {
    let mut fixture = fixture(2);
    let mut scene = scene(&fixture.harness);
    for frame in &mut scene.frames {
        frame.camera = Camera::pinhole(16, 40, 30.0);
    }
    let digest = fixture.harness.put(&scene.encode().unwrap());
    fixture.inputs.0.insert("scene".to_owned(), digest);
    for member in &mut fixture.members {
        member.insert("weights".into(), digest); // no field: reading it would fail
    }
    let params = json!({"b": 2, "width": 1280, "viewpoints": "orbit"});
    let stage = Bootstrap::new(serde_json::from_value(params).unwrap()).unwrap();
    let refused = stage.reduce(&fixture.harness.ctx(), &fixture.inputs, &fixture.members);
    let error = refused.unwrap_err().to_string();
    assert!(error.contains("a video has at most 3840 x 2160"), "{error}");
}

/// If this digest changes and `Bootstrap::VERSION` does not, raise the version.
#[test]
fn the_answer_belongs_to_the_version() {
    let (_, outputs) = fixture(2).reduce(json!({"b": 2, "frames": 2, "width": 24, "device": "cpu"}));
    let all = Digest::of(&serde_json::to_vec(&outputs).unwrap());
    assert_eq!((Bootstrap::VERSION, all.short().as_str()), (5, "5efba425f57e"));
}

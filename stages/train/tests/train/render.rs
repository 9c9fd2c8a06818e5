//! Paths, layers and films of the stage `render`, on a tiny scene with the real field.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::common::{inputs, json, put_scene, run, scene, small, stage};
use marf_cache::Digest;
use marf_scene::{Camera, Photo, Pose, Scene, picture::png16::read_quantity};
use marf_stage::{Ctx, Define, Inputs, Memos, harness::Harness};
use marf_train::{Render, Train};
use serde_json::{Value, json};

/// Trains a field and returns its outputs as inputs of `render`.
fn downstream(harness: &Harness) -> Inputs {
    after(harness, 32)
}

fn after(harness: &Harness, steps: u64) -> Inputs {
    let scene = put_scene(harness, &scene(harness, 12));
    let train: Train = stage(json!({"steps": steps, "field": small()}));
    let trained = run(&train, &harness.ctx(), &inputs(&[("scene", scene)])).unwrap();
    inputs(&[("weights", trained["weights"]), ("scene", trained["scene"])])
}

#[test]
fn render_makes_numbered_pictures_their_order_and_depth() {
    let harness = Harness::default();
    let inputs = downstream(&harness);
    for (path, frames) in [("flythrough", 3), ("orbit", 3), ("heldout", 3), ("train", 3)] {
        let render: Render = stage(json!({"path": path, "frames": 3, "width": 32}));
        let outputs = run(&render, &harness.ctx(), &inputs).unwrap();
        let poses = json(&harness, &outputs, "poses");
        assert_eq!(poses.as_array().unwrap().len(), frames, "{path}");
        let film = json(&harness, &outputs, "film");
        let pictures = [1, 2, 3].map(|index| outputs[&format!("frames/000{index}.png")].to_string());
        assert_eq!(film, json!(pictures), "{path}");
        let picture = Photo::decode(&harness.get(&outputs["frames/0003.png"]).unwrap())
            .unwrap()
            .image;
        assert_eq!((picture.width, picture.height), (32, 24), "{path}");
    }
}

/// Two members that are equal differ nowhere.
#[test]
fn layers_stand_side_by_side_in_the_film_and_as_values_of_16_bits() {
    let harness = Harness::default();
    // As many steps as a surface needs.
    let mut inputs = after(&harness, 200);
    let all = json!({"path": "orbit", "frames": 2, "width": 32, "height": 20, "outputs": ["rgb", "depth", "uncertainty"]});
    let render: Render = stage(all);
    let error = run(&render, &harness.ctx(), &inputs).unwrap_err();
    assert!(error.to_string().contains("`members`"), "{error}");
    let weights = inputs.0["weights"];
    let members = serde_json::to_vec(&json!([weights.to_string(), weights.to_string()])).unwrap();
    inputs.0.insert("members".to_owned(), harness.put(&members));
    let outputs = run(&render, &harness.ctx(), &inputs).unwrap();
    let values = |name: &str, quantity: &str| {
        let png = harness.get(&outputs[name]).unwrap();
        read_quantity(&png, quantity).unwrap()
    };
    let (width, height, depth) = values("depth/0001.png", "depth");
    assert_eq!((width, height), (32, 20));
    let deep = depth.iter().filter(|depth| **depth > 0.0).count();
    assert!(deep > 64, "{deep} of 640 pixels have a depth");
    let (.., spread) = values("uncertainty/0002.png", "uncertainty");
    assert_eq!(spread, [0.0; 32 * 20], "equal members differ nowhere");
    let picture = |digest: &Digest| Photo::decode(&harness.get(digest).unwrap()).unwrap().image;
    let preview = picture(&outputs["depth-preview/0001.png"]);
    let film: Vec<Digest> = serde_json::from_value(json(&harness, &outputs, "film")).unwrap();
    let first = picture(&film[0]);
    assert!(
        first.width >= 3 * 32 && first.height == preview.height,
        "{} x {}",
        first.width,
        first.height
    );
    let only: Render =
        stage(json!({"path": "orbit", "frames": 2, "width": 32, "height": 20, "outputs": ["depth"]}));
    let outputs = run(&only, &harness.ctx(), &inputs).unwrap();
    let film: Vec<Digest> = serde_json::from_value(json(&harness, &outputs, "film")).unwrap();
    assert_eq!(film[0], outputs["depth-preview/0001.png"]);
    assert!(!outputs.contains_key("frames/0001.png"));
}

/// Memos that count the saved ones.
struct Counted<'a> {
    memos: &'a dyn Memos,
    saved: AtomicUsize,
}

impl Memos for Counted<'_> {
    fn load(&self, key: &Digest) -> Option<Arc<[u8]>> {
        self.memos.load(key)
    }

    fn save(&self, key: &Digest, value: &[u8]) {
        self.saved.fetch_add(1, Ordering::Relaxed);
        self.memos.save(key, value);
    }
}

/// A layer is saved when it was rendered: colour and depth by one render.
#[test]
fn what_is_known_of_a_camera_is_not_rendered_again_for_other_outputs_or_another_path() {
    let harness = Harness::default();
    let inputs = downstream(&harness);
    let counted = Counted {
        memos: &harness,
        saved: AtomicUsize::new(0),
    };
    let ctx = Ctx {
        memos: &counted,
        ..harness.ctx()
    };
    let made = |table: Value| {
        let outputs = run(&stage::<Render>(table), &ctx, &inputs).unwrap();
        (outputs, counted.saved.swap(0, Ordering::Relaxed))
    };
    let (colours, saved) = made(json!({"path": "train", "frames": 3, "width": 32}));
    assert_eq!(saved, 6);
    let (both, saved) = made(json!({"path": "train", "frames": 3, "width": 32, "outputs": ["rgb", "depth"]}));
    assert_eq!(saved, 0);
    let frame = |number: u32| format!("frames/{number:04}.png");
    assert!((1..=3).all(|number| both[&frame(number)] == colours[&frame(number)]));
    let poses = json(&harness, &both, "poses");
    let (stills, saved) = made(json!({"path": "stills", "width": 32, "keyframes": [poses[1], poses[0]]}));
    assert_eq!((saved, stills[&frame(1)]), (0, colours[&frame(2)]));
    let (_, saved) = made(json!({"path": "train", "frames": 3, "width": 16}));
    assert_eq!(saved, 6, "another size");
    let other = after(&harness, 40);
    run(
        &stage::<Render>(json!({"path": "train", "frames": 3, "width": 32})),
        &ctx,
        &other,
    )
    .unwrap();
    assert_eq!(counted.saved.load(Ordering::Relaxed), 6, "another field");
}

#[test]
fn keyframes_are_passed_in_their_order_and_stills_are_taken_at_each() {
    let harness = Harness::default();
    let inputs = downstream(&harness);
    let train: Render = stage(json!({"path": "train", "frames": 3, "width": 32}));
    let known = json(&harness, &run(&train, &harness.ctx(), &inputs).unwrap(), "poses");
    let places = |path: &str| {
        let render: Render = stage(json!({"path": path, "keyframes": known, "frames": 5, "width": 16}));
        json(&harness, &run(&render, &harness.ctx(), &inputs).unwrap(), "poses")
    };
    let stills = places("stills");
    assert_eq!(stills.as_array().unwrap().len(), 3);
    assert_eq!(stills[1]["cam_from_world"], known[1]["cam_from_world"]);
    assert_eq!(
        (&stills[1]["name"], &stills[1]["camera"]["width"]),
        (&known[1]["name"], &json!(16))
    );
    let film = places("keyframes");
    assert_eq!(film.as_array().unwrap().len(), 5);
    let near = |a: &Value, b: &Value| {
        let numbers = |pose: &Value| -> Vec<f64> {
            let rows = pose["cam_from_world"].as_array().unwrap().iter();
            rows.flat_map(|row| {
                row.as_array()
                    .unwrap()
                    .iter()
                    .map(|number| number.as_f64().unwrap())
            })
            .collect()
        };
        let pairs = numbers(a).into_iter().zip(numbers(b));
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) < 1e-9
    };
    assert!(near(&film[0], &known[0]) && near(&film[4], &known[2]));
}

#[test]
fn a_film_that_no_video_can_hold_is_refused_before_its_first_picture_and_a_still_is_not() {
    let harness = Harness::default();
    let inputs = downstream(&harness);
    let wide = json!({"path": "orbit", "frames": 1, "width": 2000, "height": 1, "outputs": ["rgb", "depth"]});
    let render: Render = stage(wide);
    let error = run(&render, &harness.ctx(), &inputs).unwrap_err();
    assert!(error.to_string().contains("4000"), "{error}");
    let place =
        json!({"name": "a", "camera": Camera::pinhole(4000, 1, 9e3), "cam_from_world": Pose::identity()});
    let still: Render = stage(json!({"path": "stills", "width": 4000, "keyframes": [place]}));
    run(&still, &harness.ctx(), &inputs).unwrap();
}

#[test]
fn photos_whose_up_directions_cancel_out_have_no_orbit() {
    let harness = Harness::default();
    let mut inputs = downstream(&harness);
    let mut scene = Scene::decode(&harness.get(&inputs.0["scene"]).unwrap()).unwrap();
    scene.up = None;
    scene.frames.truncate(2);
    let half_turn = Pose {
        rotation: nalgebra::Matrix3::from_diagonal(&nalgebra::Vector3::new(-1.0, -1.0, 1.0)),
        ..Pose::identity()
    };
    for (frame, rotation) in scene.frames.iter_mut().zip([Pose::identity(), half_turn]) {
        frame.held_out = false;
        frame.cam_from_world = rotation;
    }
    inputs
        .0
        .insert("scene".to_owned(), harness.put(&scene.encode().unwrap()));
    let render: Render = stage(json!({"path": "orbit", "frames": 1, "width": 8}));
    let error = run(&render, &harness.ctx(), &inputs).unwrap_err();
    assert!(
        error.to_string().contains("up direction of the scene is unknown"),
        "{error}"
    );
}

#[test]
fn a_picture_of_nothing_is_refused_by_its_key() {
    for (key, value) in [("frames", 0), ("width", 0), ("width", 5000)] {
        let params = serde_json::from_value(json!({ key: value })).unwrap();
        assert_eq!(Render::new(params).unwrap_err().path, key);
    }
}

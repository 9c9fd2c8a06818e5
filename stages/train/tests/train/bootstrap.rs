//! The reduction on real fields: a wall photographed from one side, seen from there and from elsewhere.

use marf_cache::Digest;
use marf_field::{Overrides, Trainer, View};
use marf_scene::{Camera, Frame, Image, Photo, Point, Pose, Scene, Srgb, encode_png};
use marf_schema::{
    bootstrap::{BootstrapParams, Metrics},
    example, train,
};
use marf_stage::{Define, Document, Expand, Inputs, Outputs, TypedOutputs, harness::Harness};
use marf_train::Bootstrap;
use nalgebra::Vector3;
use serde_json::json;

const WIDTH: u32 = 32;
const HEIGHT: u32 = 24;

/// Colour of the wall y = 0 at (x, z), or of the sky in a direction.
type Seen = fn(hit: Vector3<f64>, ray: Vector3<f64>) -> [u8; 3];

/// Stripes of a wall. The cameras are at y = -3.
fn stripes(hit: Vector3<f64>, _ray: Vector3<f64>) -> [u8; 3] {
    if (hit.x * 2.0).floor() as i64 % 2 == 0 {
        [210, 150, 90]
    } else {
        [70, 40, 30]
    }
}

/// Stripes with a black shadow from x = -0.5 to 0.5. Above 0.6, where -z is up, there is a sky that grows dark upwards.
fn shadow_and_sky(hit: Vector3<f64>, ray: Vector3<f64>) -> [u8; 3] {
    if hit.z < -0.6 {
        let up = (-ray.z / ray.norm()).clamp(0.0, 1.0);
        [120, 140, 230 - (150.0 * up) as u8]
    } else if hit.x.abs() < 0.5 {
        [3, 3, 3]
    } else {
        stripes(hit, ray)
    }
}

fn photo(cam_from_world: &Pose, seen: Seen) -> Image<Srgb> {
    let camera = Camera::pinhole(WIDTH, HEIGHT, 30.0);
    let world_from_cam = cam_from_world.inverse();
    Image::from_fn(WIDTH, HEIGHT, |column, row| {
        let pixel = nalgebra::Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let ray = world_from_cam.direction(&camera.unproject(&pixel).unwrap());
        let eye = cam_from_world.centre();
        let hit = eye - ray * (eye.y / ray.y);
        seen(hit, ray)
    })
}

fn frame(harness: &Harness, id: &str, eye: Vector3<f64>, target: Vector3<f64>, seen: Seen) -> Frame {
    let cam_from_world = Pose::looking_at(eye, target, Vector3::z());
    Frame {
        id: id.to_owned(),
        file: format!("{id}.png"),
        image: harness.put(&encode_png(&photo(&cam_from_world, seen)).unwrap()),
        camera: Camera::pinhole(WIDTH, HEIGHT, 30.0),
        cam_from_world,
        held_out: true,
        mask: None,
        error_px: None,
    }
}

fn scene(harness: &Harness, seen: Seen) -> Scene {
    let along = |index: u32| {
        let eye = Vector3::new(f64::from(index) * 0.4 - 1.8, -3.0, f64::from(index % 3) * 0.3);
        Frame {
            held_out: index % 2 == 1,
            ..frame(harness, &format!("{index:02}"), eye, Vector3::zeros(), seen)
        }
    };
    Scene {
        frames: (0..10).map(along).collect(),
        up: Some([0.0, 0.0, -1.0]),
        ..Scene::default()
    }
}

fn member(harness: &Harness, scene: &Scene, seed: u64, steps: u64, background: &str) -> Outputs {
    let decode = |frame: &Frame| Photo::decode(&harness.get(&frame.image).unwrap()).unwrap().image;
    let (held_out, training): (Vec<_>, Vec<_>) = scene.frames.iter().partition(|frame| frame.held_out);
    let view = |frame: &&Frame| View {
        id: frame.id.clone(),
        camera: frame.camera,
        cam_from_world: frame.cam_from_world,
        image: decode(frame).into(),
        distances: Vec::new(),
    };
    let keys = json!({"levels": 4, "log2_table": 11, "finest_resolution": 64, "density_width": 16, "color_width": 16,
        "batch_samples": 2048, "occupancy_resolution": 32, "background": background});
    let config = serde_json::from_value::<Overrides>(keys)
        .unwrap()
        .over(&Default::default())
        .unwrap();
    let views = training.iter().map(view).collect();
    let points: Vec<[f64; 3]> = scene.points.iter().map(|point| point.position).collect();
    let mut trainer = Trainer::new(views, &points, &config, seed).unwrap();
    for _ in 0..steps {
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
    let scene = scene(&harness, stripes);
    let members = (0..count)
        .map(|seed| member(&harness, &scene, seed, 80, "black"))
        .collect();
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
fn photos_give_maps_and_figures() {
    let fixture = fixture(3);
    let (report, outputs) = fixture.reduce(json!({"b": 3}));
    let held_out = report.heldout.unwrap();
    assert!(
        held_out.mean.psnr > held_out.psnr_members_mean - 8.0,
        "{held_out:?}"
    );
    assert!((0.0..=1.0).contains(&held_out.coverage.sd2), "{held_out:?}");
    let calibration = held_out.calibration.unwrap();
    assert_eq!(calibration.views, 5);
    assert!((0.0..=1.0).contains(&calibration.coverage90), "{calibration:?}");
    assert_eq!(held_out.depth_calibration, None, "the scene has no sparse points");
    assert!(
        report.std > report.std_paper && report.std_paper > 0.0,
        "{}",
        report.std
    );
    for kind in [
        "mean",
        "photo",
        "std",
        "unseen",
        "total",
        "coverage",
        "interval",
        "depth-std",
        "error",
    ] {
        assert!(
            outputs.contains_key(&format!("maps/03-{kind}.png")),
            "{kind}: {:?}",
            outputs.keys()
        );
    }
    for kind in [
        "std",
        "total",
        "interval",
        "depth",
        "depth-std",
        "error",
        "rgb-std",
        "coverage",
    ] {
        let array = fixture
            .harness
            .get(&outputs[&format!("maps/03-{kind}.npy")])
            .unwrap();
        let channels = if matches!(kind, "rgb-std" | "coverage") {
            3
        } else {
            1
        };
        assert_eq!(
            array.len(),
            128 + 4 * channels * (WIDTH * HEIGHT) as usize,
            "{kind}"
        );
    }
    assert!(!outputs.contains_key("film"), "`render` makes films");
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
    let params = json!({"b": 3});
    let (_, before) = fixture.reduce(params.clone());
    fixture.members.rotate_left(1);
    let (_, after) = fixture.reduce(params);
    for (name, digest) in &before {
        let lists_members = ["metrics", "members"].contains(&name.as_str());
        assert_eq!(after[name] != *digest, lists_members, "{name}");
    }
}

impl Fixture {
    /// Reads an array of maps, `channels` values a pixel.
    fn array(&self, outputs: &Outputs, name: &str, channels: usize) -> Vec<Vec<f32>> {
        let bytes = self.harness.get(&outputs[&format!("maps/{name}.npy")]).unwrap();
        let values: Vec<f32> = bytes[128..]
            .as_chunks::<4>()
            .0
            .iter()
            .map(|value| f32::from_le_bytes(*value))
            .collect();
        values.chunks(channels).map(<[f32]>::to_vec).collect()
    }
}

fn median(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values[values.len() / 2]
}

/// A wall with a black shadow below a learnt sky, and a view of a part of it that no photo trained on shows. Shadow and sky were seen, and
/// the hole was not.
#[test]
fn shadow_and_sky_are_told_apart_from_a_hole() {
    let harness = Harness::default();
    let mut scene = scene(&harness, shadow_and_sky);
    let aside = frame(
        &harness,
        "aside",
        Vector3::new(2.0, -3.0, 0.0),
        Vector3::new(9.0, 0.0, 0.4),
        shadow_and_sky,
    );
    scene.frames.push(aside);
    let on_wall = |index: u32| Point {
        position: [
            f64::from(index % 12) * 0.4 - 2.2,
            0.0,
            f64::from(index / 12) * 0.3 - 0.6,
        ],
        color: None,
        views: 3,
    };
    scene.points = (0..72).map(on_wall).collect();
    let members = (0..3)
        .map(|seed| member(&harness, &scene, seed, 250, "direction"))
        .collect();
    let inputs = Inputs([("scene".to_owned(), harness.put(&scene.encode().unwrap()))].into());
    let fixture = Fixture {
        harness,
        inputs,
        members,
    };
    let (report, outputs) = fixture.reduce(json!({"b": 3}));
    keep(&fixture.harness, &outputs);

    let total = |view: &str| -> Vec<f32> { fixture.array(&outputs, &format!("{view}-total"), 1).concat() };
    let all: Vec<f32> = ["01", "03", "05", "07", "09"]
        .into_iter()
        .flat_map(total)
        .collect();
    let hole = median(total("aside"));
    assert!(
        hole >= 3.0 * median(all.clone()),
        "hole {hole}, scene {}",
        median(all)
    );
    let aside = report.views.iter().find(|view| view.name == "aside").unwrap();
    assert!(aside.unseen_share > 0.7, "{aside:?}");

    // View 05 looks at the shadow from 0.2 off its middle. Its first rows are sky.
    let (middle, rows) = (total("05"), WIDTH as usize);
    let shadow = middle[12 * rows + 14..][..3].to_vec();
    let sky = middle[..2 * rows].to_vec();
    assert!(
        median(shadow.clone()) < hole / 3.0,
        "shadow {shadow:?}, hole {hole}"
    );
    assert!(median(sky.clone()) < hole / 3.0, "sky {sky:?}, hole {hole}");
    let seen = report.views.iter().find(|view| view.name == "05").unwrap();
    assert!(seen.unseen_share < 0.15 && seen.sky_share > 0.1, "{seen:?}");
    let coverage = fixture.array(&outputs, "05-coverage", 3);
    let below = &coverage[14 * rows + 4];
    assert!(
        below[0] >= 3.0 && below[1] > 2.5 && below[1] < 4.5,
        "photos, distance, angle: {below:?}"
    );
}

/// One colour where x < 0, and beyond that a pattern finer than the cells of the field.
fn half_too_fine(hit: Vector3<f64>, ray: Vector3<f64>) -> [u8; 3] {
    if hit.x < 0.0 {
        [140, 95, 60]
    } else {
        stripes(hit * 8.0, ray)
    }
}

#[test]
fn what_all_members_get_wrong_alike_is_in_the_total() {
    let harness = Harness::default();
    let scene = scene(&harness, half_too_fine);
    // Three times the same field: they differ in nothing.
    let members = vec![member(&harness, &scene, 0, 80, "black"); 3];
    let inputs = Inputs([("scene".to_owned(), harness.put(&scene.encode().unwrap()))].into());
    let fixture = Fixture {
        harness,
        inputs,
        members,
    };
    let (report, outputs) = fixture.reduce(json!({"b": 3}));
    assert!(report.std < 1e-6, "{}", report.std);
    let middle_of = |kind: &str, from: usize| {
        let map = fixture.array(&outputs, &format!("05-{kind}"), 1).concat();
        let rows = map.chunks(WIDTH as usize);
        median(rows.flat_map(|row| row[from..from + 8].to_vec()).collect())
    };
    // View 05 looks along y, with -z upwards: x < 0 is on its right.
    let [total, error] = ["total", "error"].map(|kind| (middle_of(kind, 22), middle_of(kind, 2)));
    assert!(error.1 > 2.0 * error.0, "plain, too fine: errors {error:?}");
    assert!(total.1 > 1.5 * total.0, "plain, too fine: total {total:?}");
}

#[test]
fn photos_that_a_member_did_not_draw_test_it() {
    let mut fixture = fixture(2);
    let draws: [&[&str]; 2] = [&["00", "02", "04", "06", "06"], &["00", "02", "08", "08", "08"]];
    for (member, drawn) in fixture.members.iter_mut().zip(draws) {
        let mut metrics = train::Metrics::decode(&fixture.harness.get(&member["metrics"]).unwrap()).unwrap();
        metrics.drawn = Some(drawn.iter().map(|id| (*id).to_owned()).collect());
        member.put(&fixture.harness.ctx(), &metrics).unwrap();
    }
    let (report, _) = fixture.reduce(json!({"b": 2, "mode": "photos"}));
    assert!(fixture.reduce(json!({"b": 2})).0.out_of_bag.is_none());
    let found = report.out_of_bag.unwrap();
    assert_eq!(found.photos, 3, "04, 06 and 08; all others were drawn by both");
    assert!(
        found.psnr > 10.0 && found.psnr_in_bag.unwrap() > 10.0,
        "{found:?}"
    );
}

#[test]
fn a_path_has_maps_without_photos() {
    let fixture = fixture(2);
    let (report, outputs) = fixture.reduce(json!({"b": 2, "viewpoints": "orbit", "map_frames": 2}));
    assert_eq!((report.heldout, report.views.len()), (None, 2));
    assert!(
        outputs.contains_key("maps/orbit-0002-std.png") && !outputs.contains_key("maps/orbit-0002-photo.png")
    );
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
    let refused = |fixture: &Fixture| {
        let reduced = stage.reduce(&fixture.harness.ctx(), &fixture.inputs, &fixture.members);
        reduced.unwrap_err().to_string()
    };
    assert_eq!(refused(&fixture), "member 01 has no output `weights`");
    fixture.members[1].insert("weights".into(), fixture.harness.put(b"junk"));
    let error = refused(&fixture);
    assert!(error.starts_with("member 01, output `weights`: "), "{error}");
}

/// If this digest changes and `Bootstrap::VERSION` does not, raise the version.
#[test]
fn the_answer_belongs_to_the_version() {
    let (_, outputs) = fixture(2).reduce(json!({"b": 2, "device": "cpu"}));
    let all = Digest::from_content(&serde_json::to_vec(&outputs).unwrap());
    assert_eq!((Bootstrap::VERSION, all.short().as_str()), (18, "fc48ed0a66f3"));
}

//! A tiny scene: a checkered floor, photographed from a ring of cameras.
#![allow(dead_code, reason = "each test file uses a part")]

use std::sync::Arc;

use marf_cache::Digest;
use marf_scene::{Camera, Frame, Image, Pose, Scene, Srgb, encode_png};
use marf_stage::{Ctx, Define, Inputs, Memos, Outputs, Stage, StageError, Work, harness::Harness};
use nalgebra::Vector3;
use serde_json::Value;

pub const WIDTH: u32 = 24;
pub const HEIGHT: u32 = 18;

/// Returns the colour a ray meets: floor z = 0 in squares of one unit, sky above. z points down.
fn color(eye: &Vector3<f64>, ray: &Vector3<f64>) -> [u8; 3] {
    if ray.z <= 0.0 {
        return [120, 160, 220];
    }
    let hit = eye - ray * (eye.z / ray.z);
    let odd = (hit.x.floor() as i64 + hit.y.floor() as i64).rem_euclid(2) == 1;
    if odd { [200, 120, 60] } else { [60, 40, 30] }
}

fn photo(camera: &Camera, cam_from_world: &Pose) -> Image<Srgb> {
    let world_from_cam = cam_from_world.inverse();
    let eye = cam_from_world.centre();
    Image::from_fn(camera.width, camera.height, |column, row| {
        let pixel = nalgebra::Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let ray = world_from_cam.direction(&camera.unproject(&pixel).unwrap());
        color(&eye, &ray)
    })
}

/// Places on a ring of radius 3, 2 above the floor, looking at its middle. Exact, without sin or cos.
fn ring(index: u32, count: u32) -> Vector3<f64> {
    let t = (f64::from(index) + 0.5) / f64::from(count) * 4.0;
    let (side, along) = (t as u32, t.fract() * 2.0 - 1.0);
    let (x, y) = match side {
        0 => (1.0, along),
        1 => (-along, 1.0),
        2 => (-1.0, -along),
        _ => (along, -1.0),
    };
    Vector3::new(3.0 * x, 3.0 * y, -2.0)
}

/// Stores photos and scene. Every 4th photo from the third is held out.
pub fn scene(harness: &Harness, count: u32) -> Scene {
    scene_of(harness, count, WIDTH, HEIGHT)
}

/// As [`scene`], with photos of that size.
pub fn scene_of(harness: &Harness, count: u32, width: u32, height: u32) -> Scene {
    let frame = |index: u32| {
        let camera = Camera::pinhole(width, height, f64::from(width) / 1.2);
        let cam_from_world = Pose::looking_at(ring(index, count), Vector3::zeros(), Vector3::z());
        let png = encode_png(&photo(&camera, &cam_from_world)).unwrap();
        Frame {
            id: format!("{index:03}"),
            file: format!("images/{index:03}.png"),
            image: harness.put(&png),
            camera,
            cam_from_world,
            held_out: index % 4 == 2,
            mask: None,
            error_px: None,
        }
    };
    Scene {
        frames: (0..count).map(frame).collect(),
        up: Some([0.0, 0.0, -1.0]),
        metres_per_unit: Some(1.0),
        ..Scene::default()
    }
}

pub fn put_scene(harness: &Harness, scene: &Scene) -> Digest {
    harness.put(&scene.encode().unwrap())
}

pub fn inputs(named: &[(&str, Digest)]) -> Inputs {
    let owned = named.iter().map(|(name, digest)| ((*name).to_owned(), *digest));
    Inputs(owned.collect())
}

/// A field small enough for a test.
pub fn small() -> Value {
    serde_json::json!({
        "levels": 4, "features": 4, "log2_table": 11, "finest_resolution": 64, "density_width": 16,
        "color_width": 16, "batch_samples": 2048, "occupancy_resolution": 32,
    })
}

pub fn stage<S: Define>(params: Value) -> S {
    S::new(serde_json::from_value(params).unwrap()).unwrap()
}

pub fn run(stage: &dyn Stage, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
    match stage.work() {
        Work::Set(set) => set.run(ctx, inputs),
        _ => panic!("not a set stage: reduce it"),
    }
}

pub fn json(harness: &Harness, outputs: &Outputs, name: &str) -> Value {
    serde_json::from_slice(&harness.get(&outputs[name]).unwrap()).unwrap()
}

/// Keeps nothing.
pub struct NoMemos;

impl Memos for NoMemos {
    fn load(&self, _key: &Digest) -> Option<Arc<[u8]>> {
        None
    }

    fn save(&self, _key: &Digest, _table: &[u8]) {}
}

//! A ball in front of a sky: photos, settings and trainings that tests share.

use marf_scene::{Camera, Image, Pose};
use nalgebra::Vector3;

use crate::cpu::clearance::Clearance;
use crate::cpu::simd::InstructionSet;
use crate::model::Model;
use crate::render::{Accuracy, Viewpoint};
use crate::{Config, Field, Gain, Render, Trainer, View};

/// A ball of radius 1 with a wavy coat before a sky that grows lighter upwards.
fn shade(origin: Vector3<f64>, direction: Vector3<f64>) -> [u8; 3] {
    let toward = -origin.dot(&direction);
    let miss = (origin + direction * toward).norm_squared();
    if miss > 1.0 || toward < 0.0 {
        let up = 0.5 + 0.5 * direction.z;
        return [
            (90.0 + 60.0 * up) as u8,
            (110.0 + 60.0 * up) as u8,
            (150.0 + 80.0 * up) as u8,
        ];
    }
    let hit = origin + direction * (toward - (1.0 - miss).sqrt());
    let wave = (hit.x * 4.0).sin() * (hit.y * 4.0).cos() + 0.5 * hit.z;
    [160.0 + 60.0 * wave, 110.0 - 40.0 * wave, 80.0 + 20.0 * wave].map(|channel| channel as u8)
}

/// Returns a view of the ball, `width` pixels a side, at `angle` around it, rad, and `height`.
pub fn ball_view(angle: f64, height: f64, width: u32) -> View {
    let eye = Vector3::new(3.0 * angle.cos(), 3.0 * angle.sin(), height);
    let camera = Camera::pinhole(width, width, f64::from(width));
    let cam_from_world = Pose::looking_at(eye, Vector3::zeros(), -Vector3::z());
    let image = Image::from_fn(width, width, |column, row| {
        let pixel = nalgebra::Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let ray = cam_from_world
            .inverse()
            .direction(&camera.unproject(&pixel).unwrap());
        shade(eye, ray.normalize())
    });
    View {
        id: format!("ball {angle:.2}"),
        camera,
        cam_from_world,
        image: image.into(),
        distances: Vec::new(),
    }
}

/// Returns `count` views around the ball.
pub fn ball(count: u32, width: u32) -> Vec<View> {
    let angle = |index: u32| f64::from(index) / f64::from(count) * std::f64::consts::TAU;
    (0..count)
        .map(|index| ball_view(angle(index), [0.8, -0.6][index as usize % 2], width))
        .collect()
}

/// Returns the settings of a field that is trained within seconds.
pub fn small() -> Config {
    Config {
        levels: Some(4),
        log2_table: Some(11),
        base_resolution: 8,
        density_width: 16,
        color_width: 16,
        batch_samples: 1024,
        occupancy_resolution: 32,
        cone: 0.1,
        min_step: 0.05,
        near: Some(0.2),
        gain: Gain::PerPhoto,
        ..Config::default()
    }
}

/// Trains for `steps` steps.
///
/// # Panics
/// If the training is refused.
pub fn trained(views: Vec<View>, config: &Config, seed: u64, steps: u32) -> Trainer {
    let mut trainer = Trainer::new(views, &[], config, seed).unwrap();
    for _ in 0..steps {
        trainer.advance(1).unwrap();
    }
    trainer
}

/// Returns the PSNR of a picture of a view, dB.
///
/// # Panics
/// If the picture fails.
pub fn psnr(field: &Field, view: &View) -> f64 {
    let found = field
        .render(&view.camera, &view.cam_from_world)
        .unwrap()
        .to_image();
    let pairs = found
        .pixels
        .as_flattened()
        .iter()
        .zip(view.image.pixels.as_flattened());
    let sum: f64 = pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    -10.0
        * (sum / (3 * found.pixels.len()) as f64 / 65025.0)
            .max(1e-10)
            .log10()
}

/// Renders every sample of every ray of a photo, on the CPU.
pub fn exact(model: &Model, camera: &Camera, cam_from_world: &Pose) -> Render {
    let viewpoint = Viewpoint {
        level: InstructionSet::best(),
        model,
        clearance: &Clearance::new(&model.bits),
        camera,
        world_from_cam: cam_from_world.inverse(),
        accuracy: Accuracy::EXACT,
    };
    viewpoint.rows(0..camera.height)
}

//! A ball on chequered ground below a sky, seen from a ring: rays of all lengths, as in photos of a rover.

use marf_field::View;
use marf_scene::{Camera, Image, Pose};
use nalgebra::{Vector2, Vector3};

/// Photos and the pixels a side of each.
const PHOTOS: u32 = 16;
const SIDE: u32 = 160;

pub fn views() -> Vec<View> {
    (0..PHOTOS).map(view).collect()
}

fn view(index: u32) -> View {
    let angle = f64::from(index) / f64::from(PHOTOS) * std::f64::consts::TAU;
    let height = [0.4, 1.2][index as usize % 2];
    let eye = Vector3::new(3.0 * angle.cos(), 3.0 * angle.sin(), height);
    let camera = Camera::pinhole(SIDE, SIDE, f64::from(SIDE));
    let cam_from_world = Pose::looking_at(eye, Vector3::zeros(), -Vector3::z());
    let world_from_cam = cam_from_world.inverse();
    let image = Image::from_fn(SIDE, SIDE, |column, row| {
        let pixel = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let in_camera = camera.unproject(&pixel).expect("a pinhole sees all its pixels");
        colour(eye, world_from_cam.direction(&in_camera).normalize())
    });
    View {
        id: format!("photo {index}"),
        camera,
        cam_from_world,
        image: image.into(),
        distances: Vec::new(),
    }
}

/// The ball has radius 1 and is on the ground at z = -1.
fn colour(eye: Vector3<f64>, direction: Vector3<f64>) -> [u8; 3] {
    let toward = -eye.dot(&direction);
    let miss = (eye + direction * toward).norm_squared();
    let ground = -(eye.z + 1.0) / direction.z;
    let rgb = if miss < 1.0 && toward > 0.0 {
        let hit = eye + direction * (toward - (1.0 - miss).sqrt());
        let wave = (hit.x * 9.0).sin() * (hit.y * 9.0).cos() + 0.5 * hit.z;
        [160.0 + 60.0 * wave, 110.0 - 40.0 * wave, 80.0 + 20.0 * wave]
    } else if ground > 0.0 {
        let hit = eye + direction * ground;
        let grain = (hit.x * 5.0).sin() * (hit.y * 5.0).sin();
        [150.0 + 50.0 * grain, 100.0 + 30.0 * grain, 70.0 + 20.0 * grain]
    } else {
        [200.0 - 60.0 * direction.z, 170.0 - 40.0 * direction.z, 150.0]
    };
    rgb.map(|channel| channel as u8)
}

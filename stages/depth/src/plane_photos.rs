//! Photos of a slanted plane for tests.

use marf_cache::Digest;
use marf_scene::{Camera, Image, Pose, encode_png};
use marf_stage::harness::Harness;
use nalgebra::{Vector2, Vector3};

/// The plane z = 10 + y / 2 in the world, which is that of the first camera: y down, z forward.
const SLOPE: f64 = 0.5;

pub(crate) fn height(y: f64) -> f64 {
    10.0 + SLOPE * y
}

/// Returns a number in [0, 1) of a place on a grid.
fn noise(x: i64, y: i64) -> f64 {
    let mixed =
        (x.wrapping_mul(0x9e37_79b9) ^ y.wrapping_mul(0x85eb_ca6b)).wrapping_mul(0x27d4_eb2f_1656_67c5);
    f64::from(((mixed ^ (mixed >> 29)) & 0xffff) as u16) / 65_536.0
}

/// Brightness of the plane: smooth noise of two sizes.
fn texture(x: f64, y: f64) -> f64 {
    let smooth = |x: f64, y: f64| {
        let (i, j) = (x.floor(), y.floor());
        let (u, v) = (x - i, y - j);
        let at = |di: i64, dj: i64| noise(i as i64 + di, j as i64 + dj);
        (at(0, 0) * (1.0 - u) + at(1, 0) * u) * (1.0 - v) + (at(0, 1) * (1.0 - u) + at(1, 1) * u) * v
    };
    0.5 * smooth(x * 6.0, y * 6.0) + 0.5 * smooth(x * 2.0 + 100.0, y * 2.0)
}

/// Draws the plane. What is `moved` is a patch of 2 x 1.6 units that lies this far from the middle.
pub(crate) fn painted(harness: &Harness, camera: &Camera, pose: &Pose, moved: Option<[f64; 2]>) -> Digest {
    let image = Image::from_fn(160, 120, |column, row| {
        let at = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let point = on_plane(camera, pose, &at);
        let on_patch = moved
            .map(|[x, y]| [point.x - x, point.y - y])
            .filter(|[x, y]| x.abs() < 1.0 && y.abs() < 0.8);
        let shade = on_patch.map_or_else(|| texture(point.x, point.y), |[x, y]| texture(x + 40.0, y));
        [(40.0 + 180.0 * shade) as u8; 3]
    });
    harness.put(&encode_png(&image).unwrap())
}

/// Returns where the ray of a pixel meets the plane.
pub(crate) fn on_plane(camera: &Camera, pose: &Pose, at: &Vector2<f64>) -> Vector3<f64> {
    let from = pose.centre();
    let ray = pose.inverse().direction(&camera.unproject(at).unwrap());
    from + ray * ((height(from.y) - from.z) / (ray.z - SLOPE * ray.y))
}

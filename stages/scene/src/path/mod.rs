//! Camera paths through a scene: a fly-through, an orbit, the poses of the photos, or given ones.
//!
//! Only + - * / and sqrt, so that a path has the same bits on every machine.

mod flythrough;
mod orbit;

use marf_numeric::lower_median;
use nalgebra::Vector3;

use crate::{Camera, Frame, Pose, Scene};

pub use flythrough::{flythrough, through};
pub use orbit::{focus_point, orbit, up_direction};

/// A camera with its pose, and the name of its picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Viewpoint {
    /// Name of the picture: `0001`, or the name of the photo's pictures.
    pub name: String,
    /// Its camera.
    pub camera: Camera,
    /// Its pose.
    pub cam_from_world: Pose,
}

/// Returns the viewpoints of photos with their own distorted cameras, scaled to `width` pixels.
pub fn viewpoints_at<'a>(frames: impl Iterator<Item = (&'a Frame, String)>, width: u32) -> Vec<Viewpoint> {
    let viewpoints = frames.map(|(frame, name)| Viewpoint {
        name,
        camera: to_width(&frame.camera, width),
        cam_from_world: frame.cam_from_world,
    });
    viewpoints.collect()
}

/// Returns an ideal pinhole camera with the median focal length and aspect ratio of the scene's cameras.
///
/// Extremes: a scene without frames gives a square camera of one focal length.
pub fn typical_camera(scene: &Scene, width: u32) -> Camera {
    let ratio = |value: fn(&Camera) -> f64| {
        let ratios = scene.frames.iter().map(|frame| value(&frame.camera));
        lower_median(ratios).unwrap_or(1.0)
    };
    let focal = ratio(|camera| camera.fx_px / f64::from(camera.width));
    let shape = ratio(|camera| f64::from(camera.height) / f64::from(camera.width));
    let height = (shape * f64::from(width) + 0.5) as u32;
    Camera::pinhole(width, height.max(1), focal * f64::from(width))
}

/// Returns the camera of the same photo at another width, the aspect ratio kept within rounding.
pub fn to_width(camera: &Camera, width: u32) -> Camera {
    let height = f64::from(camera.height) * f64::from(width) / f64::from(camera.width);
    camera.resized(width, ((height + 0.5) as u32).max(1))
}

/// Returns the frames that are not held out.
fn training(scene: &Scene) -> Vec<&Frame> {
    scene.frames.iter().filter(|frame| !frame.held_out).collect()
}

/// Returns the mean of vectors. Without vectors it is zero.
fn mean(vectors: impl ExactSizeIterator<Item = Vector3<f64>>) -> Vector3<f64> {
    let count = vectors.len().max(1) as f64;
    vectors.fold(Vector3::zeros(), |sum, vector| sum + vector) / count
}

/// Returns the viewing direction in the world.
fn forward(pose: &Pose) -> Vector3<f64> {
    pose.rotation.row(2).transpose()
}

/// Returns viewpoints named `0001`, `0002` and so on.
fn numbered(camera: Camera, poses: impl Iterator<Item = Pose>) -> Vec<Viewpoint> {
    let viewpoints = (1_usize..).zip(poses).map(|(number, cam_from_world)| Viewpoint {
        name: format!("{number:04}"),
        camera,
        cam_from_world,
    });
    viewpoints.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a scene of cameras on a half circle of radius 4 around (1, 0, 0), 1 above it, z down, looking at it.
    pub(super) fn ring(count: u32) -> Scene {
        let frame = |index: u32| {
            let (cos, sin) = orbit::turn(f64::from(index) / f64::from(2 * count));
            let eye = Vector3::new(1.0 + 4.0 * cos, 4.0 * sin, -1.0);
            Frame {
                id: format!("{index:03}"),
                file: format!("{index:03}.png"),
                image: marf_cache::Digest::from_content(b""),
                camera: Camera::pinhole(400, 300, 320.0),
                cam_from_world: Pose::looking_at(eye, Vector3::x(), Vector3::z()),
                held_out: index % 8 == 3,
                mask: None,
                error_px: None,
            }
        };
        Scene {
            frames: (0..count).map(frame).collect(),
            up: Some([0.0, 0.0, -1.0]),
            ..Scene::default()
        }
    }

    #[test]
    fn the_typical_camera_keeps_field_of_view_and_shape() {
        let camera = typical_camera(&ring(5), 200);
        assert_eq!((camera.width, camera.height, camera.fx_px), (200, 150, 160.0));
    }

    #[test]
    fn a_photo_is_seen_from_its_own_place() {
        let scene = ring(3);
        let frame = &scene.frames[1];
        let places = viewpoints_at([(frame, "one".to_owned())].into_iter(), 40);
        assert_eq!((places[0].camera.width, places[0].camera.height), (40, 30));
        assert_eq!(places[0].cam_from_world, frame.cam_from_world);
    }
}

//! A scene with the numbers of a model of COLMAP, before it is written in one of the two forms.

use marf_scene::{Camera, Frame, Scene};
use nalgebra::Matrix3;

use crate::export::tracks::{TrackPoint, Tracks};

/// A scene with the numbers that a model of COLMAP has.
pub(super) struct Model<'a> {
    /// Distinct cameras, numbered from 1.
    pub cameras: Vec<Camera>,
    pub images: Vec<ModelImage<'a>>,
    pub points: Vec<ModelPoint<'a>>,
}

/// An image, numbered from 1.
pub(super) struct ModelImage<'a> {
    pub frame: &'a Frame,
    pub camera: u32,
    /// Position and number of the point, in the order of the points.
    pub features: Vec<([f64; 2], u64)>,
}

/// A point, numbered from 1.
pub(super) struct ModelPoint<'a> {
    pub track: &'a TrackPoint,
    /// Number of the image and index of the feature there.
    pub seen: Vec<(u32, u32)>,
}

impl<'a> Model<'a> {
    pub(super) fn new(scene: &'a Scene, tracks: &'a Tracks) -> Self {
        let mut cameras: Vec<Camera> = Vec::new();
        let mut images: Vec<ModelImage<'a>> = Vec::with_capacity(scene.frames.len());
        for frame in &scene.frames {
            let known = cameras.iter().position(|camera| *camera == frame.camera);
            if known.is_none() {
                cameras.push(frame.camera);
            }
            images.push(ModelImage {
                frame,
                camera: known.unwrap_or(cameras.len() - 1) as u32 + 1,
                features: Vec::new(),
            });
        }
        let points = (1..).zip(&tracks.points).map(|(number, track)| {
            let mut seen = Vec::new();
            for observation in &track.observations {
                if let Some(image) = images.get_mut(observation.frame as usize) {
                    seen.push((observation.frame + 1, image.features.len() as u32));
                    image.features.push((observation.pixel, number));
                }
            }
            ModelPoint { track, seen }
        });
        let points = points.collect();
        Self {
            cameras,
            images,
            points,
        }
    }
}

/// Returns COLMAP's number and name of the smallest lens that holds the camera, and its parameters.
pub(super) fn lens(camera: &Camera) -> (u32, &'static str, Vec<f64>) {
    let Camera {
        fx_px,
        fy_px,
        cx_px,
        cy_px,
        ..
    } = *camera;
    match [camera.k1, camera.k2, camera.p1, camera.p2] {
        [0.0, 0.0, 0.0, 0.0] => (1, "PINHOLE", vec![fx_px, fy_px, cx_px, cy_px]),
        [k1, 0.0, 0.0, 0.0] if fx_px == fy_px => (2, "SIMPLE_RADIAL", vec![fx_px, cx_px, cy_px, k1]),
        [k1, k2, 0.0, 0.0] if fx_px == fy_px => (3, "RADIAL", vec![fx_px, cx_px, cy_px, k1, k2]),
        [k1, k2, p1, p2] => (4, "OPENCV", vec![fx_px, fy_px, cx_px, cy_px, k1, k2, p1, p2]),
    }
}

/// Returns (w, x, y, z) of length 1 with w ≥ 0 of a rotation (Shepperd 1978: divides by the largest of the four,
/// which is at least 1/2).
pub(super) fn quaternion(r: &Matrix3<f64>) -> [f64; 4] {
    let (xx, yy, zz) = (r[(0, 0)], r[(1, 1)], r[(2, 2)]);
    let squares = [
        1.0 + xx + yy + zz,
        1.0 + xx - yy - zz,
        1.0 - xx + yy - zz,
        1.0 - xx - yy + zz,
    ];
    let (wx, wy, wz) = (
        r[(2, 1)] - r[(1, 2)],
        r[(0, 2)] - r[(2, 0)],
        r[(1, 0)] - r[(0, 1)],
    );
    let (xy, xz, yz) = (
        r[(1, 0)] + r[(0, 1)],
        r[(0, 2)] + r[(2, 0)],
        r[(2, 1)] + r[(1, 2)],
    );
    // Row i of 4 q qᵀ is 4 qᵢ q.
    let rows = [
        [squares[0], wx, wy, wz],
        [wx, squares[1], xy, xz],
        [wy, xy, squares[2], yz],
        [wz, xz, yz, squares[3]],
    ];
    let largest = rows
        .iter()
        .zip(squares)
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map_or(rows[0], |(row, _)| *row);
    let length = largest.iter().map(|part| part * part).sum::<f64>().sqrt();
    let sign = if largest[0] < 0.0 { -1.0 } else { 1.0 };
    largest.map(|part| sign * part / length)
}

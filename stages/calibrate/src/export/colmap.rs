//! A scene as COLMAP's binary model; what is written here is what `import` reads.
//!
//! Format: <https://colmap.github.io/format.html>. World to camera, x right, y down, z forward, the first pixel
//! centre at (0.5, 0.5): as here.

use marf_scene::{Camera, Scene};
use nalgebra::Matrix3;

use super::tracks::{Observation, Tracks};

/// Writes a scene and its points as `cameras.bin`, `images.bin` and `points3D.bin`.
///
/// Images are numbered from 1 in the order of [`Scene::frames`] and named by their files; frames of equal cameras
/// share one. A camera is PINHOLE, SIMPLE_RADIAL, RADIAL or OPENCV: the smallest that holds it exactly. Points
/// are numbered from 1 in their order; a observation of a frame that the scene does not have is left out.
pub fn write_colmap(scene: &Scene, tracks: &Tracks) -> [(&'static str, Vec<u8>); 3] {
    let mut cameras: Vec<Camera> = Vec::new();
    let mut camera_of = Vec::with_capacity(scene.frames.len());
    for frame in &scene.frames {
        let known = cameras.iter().position(|camera| *camera == frame.camera);
        camera_of.push(known.unwrap_or(cameras.len()) as u32 + 1);
        if known.is_none() {
            cameras.push(frame.camera);
        }
    }
    [
        ("cameras.bin", camera_file(&cameras)),
        ("images.bin", image_file(scene, &camera_of, tracks)),
        ("points3D.bin", point_file(scene.frames.len(), tracks)),
    ]
}

/// Little-endian bytes.
#[derive(Default)]
struct Bytes(Vec<u8>);

impl Bytes {
    /// Returns bytes that start with a count.
    fn counted(count: usize) -> Self {
        let mut bytes = Self::default();
        bytes.u64(count as u64);
        bytes
    }

    fn u32(&mut self, number: u32) {
        self.0.extend(number.to_le_bytes());
    }

    fn u64(&mut self, number: u64) {
        self.0.extend(number.to_le_bytes());
    }

    fn floats(&mut self, numbers: impl IntoIterator<Item = f64>) {
        self.0.extend(numbers.into_iter().flat_map(f64::to_le_bytes));
    }
}

/// Returns cameras.bin.
fn camera_file(cameras: &[Camera]) -> Vec<u8> {
    let mut bytes = Bytes::counted(cameras.len());
    for (number, camera) in (1..).zip(cameras) {
        let (model, params) = model(camera);
        bytes.u32(number);
        bytes.u32(model);
        bytes.u64(u64::from(camera.width));
        bytes.u64(u64::from(camera.height));
        bytes.floats(params);
    }
    bytes.0
}

/// Returns COLMAP's number of the smallest lens that holds the camera, and its parameters.
fn model(camera: &Camera) -> (u32, Vec<f64>) {
    let Camera {
        fx_px,
        fy_px,
        cx_px,
        cy_px,
        ..
    } = *camera;
    match [camera.k1, camera.k2, camera.p1, camera.p2] {
        [0.0, 0.0, 0.0, 0.0] => (1, vec![fx_px, fy_px, cx_px, cy_px]),
        [k1, 0.0, 0.0, 0.0] if fx_px == fy_px => (2, vec![fx_px, cx_px, cy_px, k1]),
        [k1, k2, 0.0, 0.0] if fx_px == fy_px => (3, vec![fx_px, cx_px, cy_px, k1, k2]),
        [k1, k2, p1, p2] => (4, vec![fx_px, fy_px, cx_px, cy_px, k1, k2, p1, p2]),
    }
}

/// Returns images.bin.
fn image_file(scene: &Scene, camera_of: &[u32], tracks: &Tracks) -> Vec<u8> {
    let mut features: Vec<Vec<([f64; 2], u64)>> = vec![Vec::new(); scene.frames.len()];
    for (point, track) in (1..).zip(&tracks.points) {
        for observation in &track.observations {
            if let Some(features) = features.get_mut(observation.frame as usize) {
                features.push((observation.pixel, point));
            }
        }
    }
    let mut bytes = Bytes::counted(scene.frames.len());
    for (number, ((frame, camera), features)) in (1..).zip(scene.frames.iter().zip(camera_of).zip(features)) {
        bytes.u32(number);
        bytes.floats(quaternion(&frame.cam_from_world.rotation));
        bytes.floats(frame.cam_from_world.translation.iter().copied());
        bytes.u32(*camera);
        bytes.0.extend(frame.file.bytes().chain([0]));
        bytes.u64(features.len() as u64);
        for (pixel, point) in features {
            bytes.floats(pixel);
            bytes.u64(point);
        }
    }
    bytes.0
}

/// Returns points3D.bin.
fn point_file(frames: usize, tracks: &Tracks) -> Vec<u8> {
    let mut features = vec![0_u32; frames];
    let mut bytes = Bytes::counted(tracks.points.len());
    for (number, track) in (1..).zip(&tracks.points) {
        let known = |observation: &&Observation| (observation.frame as usize) < frames;
        bytes.u64(number);
        bytes.floats(track.position);
        bytes.0.extend(track.color);
        bytes.floats([track.error_px]);
        bytes.u64(track.observations.iter().filter(known).count() as u64);
        for observation in track.observations.iter().filter(known) {
            // The features of an image come in the order of the points, as in `image_file`.
            let feature = &mut features[observation.frame as usize];
            bytes.u32(observation.frame + 1);
            bytes.u32(*feature);
            *feature += 1;
        }
    }
    bytes.0
}

/// Returns (w, x, y, z) of length 1 with w ≥ 0 of a rotation (Shepperd 1978: divides by the largest of the four,
/// which is at least 1/2).
fn quaternion(r: &Matrix3<f64>) -> [f64; 4] {
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

#[cfg(test)]
mod tests;

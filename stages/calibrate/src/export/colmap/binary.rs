//! The binary form: little-endian records behind a count.

use super::model::{Model, lens, quaternion};

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
pub(super) fn cameras(model: &Model<'_>) -> Vec<u8> {
    let mut bytes = Bytes::counted(model.cameras.len());
    for (number, camera) in (1..).zip(&model.cameras) {
        let (number_of_lens, _, params) = lens(camera);
        bytes.u32(number);
        bytes.u32(number_of_lens);
        bytes.u64(u64::from(camera.width));
        bytes.u64(u64::from(camera.height));
        bytes.floats(params);
    }
    bytes.0
}

/// Returns images.bin.
pub(super) fn images(model: &Model<'_>) -> Vec<u8> {
    let mut bytes = Bytes::counted(model.images.len());
    for (number, image) in (1..).zip(&model.images) {
        let pose = &image.frame.cam_from_world;
        bytes.u32(number);
        bytes.floats(quaternion(&pose.rotation));
        bytes.floats(pose.translation.iter().copied());
        bytes.u32(image.camera);
        bytes.0.extend(image.frame.file.bytes().chain([0]));
        bytes.u64(image.features.len() as u64);
        for (pixel, point) in &image.features {
            bytes.floats(*pixel);
            bytes.u64(*point);
        }
    }
    bytes.0
}

/// Returns points3D.bin.
pub(super) fn points(model: &Model<'_>) -> Vec<u8> {
    let mut bytes = Bytes::counted(model.points.len());
    for (number, point) in (1..).zip(&model.points) {
        bytes.u64(number);
        bytes.floats(point.track.position);
        bytes.0.extend(point.track.color);
        bytes.floats([point.track.error_px]);
        bytes.u64(point.seen.len() as u64);
        for (image, feature) in &point.seen {
            bytes.u32(*image);
            bytes.u32(*feature);
        }
    }
    bytes.0
}

//! Writes a scene as COLMAP's model, binary and text, in the form that `import` reads.
//!
//! Format: <https://colmap.github.io/format.html>. World to camera, x right, y down, z forward, the first pixel
//! centre at (0.5, 0.5): as here.

mod binary;
mod model;
mod text;

use marf_scene::Scene;

use self::model::Model;
use super::tracks::Tracks;

/// Writes a scene and its points as `cameras.bin`, `images.bin` and `points3D.bin`.
///
/// Images are numbered from 1 in the order of [`Scene::frames`] and named by their files. Frames of equal cameras share one. A camera is
/// PINHOLE, SIMPLE_RADIAL, RADIAL or OPENCV: the smallest that holds it exactly. Points are numbered from 1 in their order. An observation
/// of a frame that the scene does not have is left out.
pub fn write_colmap(scene: &Scene, tracks: &Tracks) -> [(&'static str, Vec<u8>); 3] {
    let model = Model::new(scene, tracks);
    [
        ("cameras.bin", binary::cameras(&model)),
        ("images.bin", binary::images(&model)),
        ("points3D.bin", binary::points(&model)),
    ]
}

/// Writes the same model as `cameras.txt`, `images.txt` and `points3D.txt`. Numbers are the shortest text that reads back to the same bits.
pub fn write_colmap_text(scene: &Scene, tracks: &Tracks) -> [(&'static str, String); 3] {
    let model = Model::new(scene, tracks);
    [
        ("cameras.txt", text::cameras(&model)),
        ("images.txt", text::images(&model)),
        ("points3D.txt", text::points(&model)),
    ]
}

#[cfg(test)]
mod tests;

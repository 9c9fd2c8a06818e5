//! What examples know of the true Mars: its photos with the distance that each pixel shows, and where they stand in a scene's world.

use std::error::Error;

use marf_demo::{Demo, RangeMap, TruePhoto};
use marf_scene::Scene;
use nalgebra::{Matrix3, Vector3};

/// A true photo of the scene with its ranges, and whether it is held out.
pub type Known = (TruePhoto, RangeMap, bool);

/// Returns the true photos of the scene.
pub fn true_photos(demo: &Demo, scene: &Scene) -> Result<Vec<Known>, Box<dyn Error>> {
    let mut photos = Vec::new();
    for frame in &scene.frames {
        let file = frame.file.rsplit('/').next().unwrap_or_default();
        let sol: u32 = file.get(4..8).ok_or("no sol in the name")?.parse()?;
        let truth = demo.ground_truth(sol)?.photos;
        let stem = file.rsplit_once('.').map_or(file, |(stem, _)| stem);
        let photo = truth.into_iter().find(|photo| photo.file.starts_with(stem));
        let photo = photo.ok_or_else(|| format!("{file} is no photo of the demo"))?;
        let map = demo.ranges(sol, &photo.file)?;
        photos.push((photo, map, frame.held_out));
    }
    Ok(photos)
}

/// Returns the similarity (rotation with scale, translation) that carries the camera centres of the scene to the true ones
/// (Umeyama, Least-squares estimation of transformation parameters between two point patterns, PAMI 1991).
pub fn alignment(scene: &Scene, photos: &[Known]) -> (Matrix3<f64>, Vector3<f64>) {
    let ours: Vec<Vector3<f64>> = scene
        .frames
        .iter()
        .map(|frame| frame.cam_from_world.centre())
        .collect();
    let truth: Vec<Vector3<f64>> = photos
        .iter()
        .map(|(photo, ..)| photo.cam_from_site.centre())
        .collect();
    let mean = |all: &[Vector3<f64>]| all.iter().sum::<Vector3<f64>>() / all.len() as f64;
    let (from, to) = (mean(&ours), mean(&truth));
    let pairs = || ours.iter().zip(&truth);
    let covariance: Matrix3<f64> = pairs().map(|(a, b)| (b - to) * (a - from).transpose()).sum();
    let spread: f64 = ours.iter().map(|a| (a - from).norm_squared()).sum();
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return (Matrix3::identity(), Vector3::zeros());
    };
    let sign = (u.determinant() * v_t.determinant()).signum();
    let signs = Vector3::new(1.0, 1.0, sign);
    let rotation = u * Matrix3::from_diagonal(&signs) * v_t;
    let scaled = rotation * (svd.singular_values.dot(&signs) / spread);
    (scaled, to - scaled * from)
}

//! Errors of a calibrated scene against known cameras.

use marf_scene::{Alignment, Pose, Scene};
use nalgebra::{Matrix3, Vector3};

/// Errors of a scene after the best similarity.
#[derive(Debug)]
pub struct Errors {
    pub photos: usize,
    /// Median and largest distance of a centre from the truth, share of the largest distance of two true centres.
    pub position: [f64; 2],
    /// Median and largest angle, without the rotation that all cameras have in common: a principal point's shift.
    pub rest_deg: [f64; 2],
    /// Median and largest angle.
    pub angle_deg: [f64; 2],
    /// True lengths by those of the scene.
    pub scale: f64,
}

/// Returns the errors of a scene. Photos are compared by file name, without the extension.
pub fn errors_of(scene: &Scene, truth: &[(String, Pose)]) -> Errors {
    let stem = |name: &str| name.rsplit_once('.').map_or(name, |parts| parts.0).to_owned();
    let pairs: Vec<(Pose, Pose)> = scene
        .frames
        .iter()
        .filter_map(|frame| {
            let known = truth.iter().find(|(file, _)| stem(file) == stem(&frame.file))?;
            Some((frame.cam_from_world, known.1))
        })
        .collect();
    let alignment = Alignment::fit(&pairs).unwrap();
    let rotation = alignment.rotation;
    let extent = pairs
        .iter()
        .flat_map(|a| pairs.iter().map(move |b| (a.1.centre() - b.1.centre()).norm()))
        .fold(0.0, f64::max);
    let position = pairs
        .iter()
        .map(|pair| alignment.difference(&pair.0, &pair.1).0 / extent);
    // The remaining rotation in the frame of each camera.
    let left: Vec<Matrix3<f64>> = pairs
        .iter()
        .map(|(found, known)| known.rotation * (found.rotation * rotation.transpose()).transpose())
        .collect();
    let common = nearest(&left.iter().sum());
    Errors {
        photos: pairs.len(),
        position: median_and_max(position.collect()),
        rest_deg: median_and_max(
            left.iter()
                .map(|one| angle_deg(&(common.transpose() * one)))
                .collect(),
        ),
        angle_deg: median_and_max(left.iter().map(angle_deg).collect()),
        scale: alignment.scale,
    }
}

fn nearest(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    let svd = matrix.svd(true, true);
    let (u, v_t) = (svd.u.unwrap(), svd.v_t.unwrap());
    let sign = (u * v_t).determinant().signum();
    u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t
}

fn angle_deg(r: &Matrix3<f64>) -> f64 {
    let axis = Vector3::new(
        r[(2, 1)] - r[(1, 2)],
        r[(0, 2)] - r[(2, 0)],
        r[(1, 0)] - r[(0, 1)],
    );
    axis.norm().atan2(r.trace() - 1.0).to_degrees()
}

fn median_and_max(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    [values[values.len() / 2], values[values.len() - 1]]
}

//! Errors of a calibrated scene against known cameras.

use marf_scene::{Pose, Scene};
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
    let alignment = Alignment::fit(&pairs);
    let rotation = alignment.rotation;
    let extent = pairs
        .iter()
        .flat_map(|a| pairs.iter().map(move |b| (a.1.centre() - b.1.centre()).norm()))
        .fold(0.0, f64::max);
    let position = pairs
        .iter()
        .map(|(found, known)| (alignment.point(&found.centre()) - known.centre()).norm() / extent);
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

/// A similarity: x_known = scale * rotation * x_found + translation.
struct Alignment {
    scale: f64,
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

impl Alignment {
    /// Returns the similarity of least squares between the centres of cameras, given as (found, known) poses of the same photos.
    ///
    /// S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 13(4), 1991.
    fn fit(pairs: &[(Pose, Pose)]) -> Self {
        let count = pairs.len() as f64;
        let mean =
            |side: fn(&(Pose, Pose)) -> Vector3<f64>| pairs.iter().map(side).sum::<Vector3<f64>>() / count;
        let (found, known) = (mean(|pair| pair.0.centre()), mean(|pair| pair.1.centre()));
        let apart = |pair: &(Pose, Pose)| (pair.0.centre() - found, pair.1.centre() - known);
        let covariance: Matrix3<f64> = pairs
            .iter()
            .map(|pair| {
                let (from, to) = apart(pair);
                to * from.transpose()
            })
            .sum();
        let svd = covariance.svd(true, true);
        let (u, v_t) = (svd.u.unwrap(), svd.v_t.unwrap());
        let sign = (u * v_t).determinant().signum();
        let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
        let along: f64 = pairs
            .iter()
            .map(|pair| {
                let (from, to) = apart(pair);
                to.dot(&(rotation * from))
            })
            .sum();
        let squares: f64 = pairs.iter().map(|pair| apart(pair).0.norm_squared()).sum();
        let scale = along / squares;
        Self {
            scale,
            rotation,
            translation: known - scale * (rotation * found),
        }
    }

    fn point(&self, found: &Vector3<f64>) -> Vector3<f64> {
        self.scale * (self.rotation * found) + self.translation
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

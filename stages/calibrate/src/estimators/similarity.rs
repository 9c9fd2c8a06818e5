//! Scale, turn and shift between two sets of points.

use marf_scene::Pose;
use nalgebra::{Matrix3, Vector3};

use super::svd::svd3;

/// to = scale R from + t.
#[derive(Debug, Clone)]
pub(crate) struct Similarity {
    pub scale: f64,
    pub rotation: Matrix3<f64>,
    pub translation: Vector3<f64>,
}

/// Returns the similarity of least squares from `from` to `to` (Umeyama, PAMI 1991).
///
/// `None` with fewer than three points or unequal counts, where `from` or `to` is collinear (second extent
/// below 3e-8 of the first: the turn about the line is free), or where a number is not finite.
pub(crate) fn similarity(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Option<Similarity> {
    if from.len() < 3 || from.len() != to.len() {
        return None;
    }
    let (from_mean, from_size) = spread(from)?;
    let (to_mean, to_size) = spread(to)?;
    let (mut covariance, mut variance) = (Matrix3::zeros(), 0.0);
    for (a, b) in from.iter().zip(to) {
        let (a, b) = ((a - from_mean) / from_size, (b - to_mean) / to_size);
        covariance += b * a.transpose();
        variance += a.norm_squared();
    }
    let svd = svd3(&covariance);
    if svd.s.y <= 1e-12 * svd.s.x {
        return None;
    }
    let rotation = svd.u * svd.v.transpose();
    let scale = svd.s.sum() / variance * (to_size / from_size);
    let translation = to_mean - rotation * from_mean * scale;
    let finite = scale.is_finite() && translation.iter().all(|value| value.is_finite());
    (finite && scale > 0.0).then_some(Similarity {
        scale,
        rotation,
        translation,
    })
}

/// Mean and root mean square distance from it; `None` where points are collinear or equal.
fn spread(points: &[Vector3<f64>]) -> Option<(Vector3<f64>, f64)> {
    let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let most = points
        .iter()
        .fold(0.0_f64, |most, point| most.max((point - mean).amax()));
    let scatter = points.iter().fold(Matrix3::zeros(), |sum, point| {
        let unit = (point - mean) / most;
        sum + unit * unit.transpose()
    });
    let s = svd3(&scatter).s;
    // Extents are roots of these; below the 1e-16 of rounding nothing is told apart.
    let round = s.x > 0.0 && s.y > 1e-15 * s.x && scatter.trace().is_finite();
    round.then(|| (mean, most * (scatter.trace() / points.len() as f64).sqrt()))
}

impl Similarity {
    /// Carries a point over.
    pub(crate) fn point(&self, from: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * from * self.scale + self.translation
    }

    /// Returns `cam_from_to`, in the unit of `to`: the same camera at the carried-over centre.
    pub(crate) fn pose(&self, cam_from_from: &Pose) -> Pose {
        let rotation = cam_from_from.rotation * self.rotation.transpose();
        Pose {
            rotation,
            translation: cam_from_from.translation * self.scale - rotation * self.translation,
        }
    }

    /// Returns `from` out of `to`.
    pub(crate) fn inverse(&self) -> Self {
        let (scale, rotation) = (1.0 / self.scale, self.rotation.transpose());
        Self {
            scale,
            rotation,
            translation: -(rotation * self.translation) * scale,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimators::scenes::{Scene, pose};

    #[test]
    fn a_similarity_comes_back_from_three_points_at_any_unit() {
        let turn = pose([0.4, -2.0, 1.0], [3.0, -5.0, 7.0]);
        for scale in [1e-12, 0.5, 1.0, 1e12] {
            for count in [3, 4, 50] {
                let from = Scene::new(1, count, &Pose::identity(), 0.0).points;
                let truth = Similarity {
                    scale,
                    rotation: turn.rotation,
                    translation: turn.translation * scale,
                };
                let to: Vec<_> = from.iter().map(|point| truth.point(point)).collect();
                let got = similarity(&from, &to).unwrap();
                assert!(
                    (got.scale / scale - 1.0).abs() < 1e-12,
                    "{scale:e} {count}: {}",
                    got.scale
                );
                assert!(
                    (got.rotation - truth.rotation).norm() < 1e-12,
                    "{scale:e} {count}"
                );
                let back = got.inverse().point(&to[1]);
                assert!((back - from[1]).norm() < 1e-11, "{scale:e} {count}: {back}");
            }
        }
    }

    #[test]
    fn a_carried_pose_sees_the_carried_point_in_the_same_direction() {
        let truth = pose([0.1, 0.2, 0.3], [1.0, 2.0, 3.0]);
        let map = Similarity {
            scale: 2.5,
            rotation: truth.rotation,
            translation: truth.translation,
        };
        let camera = pose([0.7, -0.1, 0.2], [0.2, 0.1, -0.4]);
        let point = Vector3::new(0.5, 0.6, 4.0);
        let (before, after) = (camera.point(&point), map.pose(&camera).point(&map.point(&point)));
        assert!((after - before * 2.5).norm() < 1e-13);
        assert!((map.pose(&camera).centre() - map.point(&camera.centre())).norm() < 1e-13);
    }

    #[test]
    fn collinear_few_equal_and_broken_points_are_refused() {
        let line: Vec<_> = (0..6)
            .map(|i| Vector3::new(1.0, 2.0, -1.0) * f64::from(i))
            .collect();
        let round = Scene::new(1, 6, &Pose::identity(), 0.0).points;
        assert!(similarity(&line, &line).is_none(), "collinear");
        assert!(similarity(&round, &line).is_none(), "onto a line");
        assert!(similarity(&round[..2], &round[..2]).is_none(), "two");
        assert!(similarity(&[round[0]; 4], &round[..4]).is_none(), "equal");
        let mut broken = round.clone();
        broken[2].x = f64::NAN;
        assert!(similarity(&broken, &round).is_none(), "NaN");
        // A mirror image has a best rotation, not a reflection.
        let mirrored: Vec<_> = round.iter().map(|p| Vector3::new(-p.x, p.y, p.z)).collect();
        assert!(similarity(&round, &mirrored).is_none_or(|s| s.rotation.determinant() > 0.0));
    }

    #[test]
    fn an_origin_a_million_away_keeps_nine_digits_of_scale() {
        let far = Vector3::new(1e6, -1e6, 2e6);
        let from: Vec<_> = Scene::new(2, 30, &Pose::identity(), 0.0)
            .points
            .iter()
            .map(|p| p + far)
            .collect();
        let to: Vec<_> = from.iter().map(|p| (p - far) * 3.0).collect();
        let got = similarity(&from, &to).unwrap();
        assert!((got.scale / 3.0 - 1.0).abs() < 1e-9, "{}", got.scale);
    }
}

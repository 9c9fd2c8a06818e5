//! Cameras against known ones: the best similarity of their frames, and the residuals.

use nalgebra::{Matrix3, Vector3};

use crate::Pose;

/// A similarity: x_known = scale * rotation * x_found + translation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alignment {
    /// Known lengths by those found.
    pub scale: f64,
    /// Known world from the one found.
    pub rotation: Matrix3<f64>,
    /// In the unit of the known world.
    pub translation: Vector3<f64>,
}

/// Share of the extent of centres along their second axis below which they count as one line: a similarity could turn about it.
const COLLINEAR: f64 = 1e-3;

impl Alignment {
    /// Returns the similarity of least squares between the centres of cameras, given as (found, known) poses of the same photos.
    ///
    /// S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 13(4), 1991.
    /// None with fewer than three cameras, with centres on one line, or with a pose that is not finite.
    pub fn fit(pairs: &[(Pose, Pose)]) -> Option<Self> {
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
        if pairs.len() < 3 || !covariance.iter().all(|value| value.is_finite()) {
            return None;
        }
        let svd = covariance.svd(true, true);
        if svd.singular_values[1] <= COLLINEAR * COLLINEAR * svd.singular_values[0] {
            return None;
        }
        let (u, v_t) = (svd.u?, svd.v_t?);
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
        Some(Self {
            scale,
            rotation,
            translation: known - scale * (rotation * found),
        })
    }

    /// Returns the distance of a camera from the known one, in the known world's unit, and the angle between them, radians.
    pub fn difference(&self, found: &Pose, known: &Pose) -> (f64, f64) {
        let centre = self.scale * (self.rotation * found.centre()) + self.translation;
        let left = known.rotation * (found.rotation * self.rotation.transpose()).transpose();
        ((centre - known.centre()).norm(), angle_rad(&left))
    }
}

/// Returns the angle of a rotation, also of a tiny one, where the cosine alone says nothing.
fn angle_rad(rotation: &Matrix3<f64>) -> f64 {
    let axis = Vector3::new(
        rotation[(2, 1)] - rotation[(1, 2)],
        rotation[(0, 2)] - rotation[(2, 0)],
        rotation[(1, 0)] - rotation[(0, 1)],
    );
    axis.norm().atan2(rotation.trace() - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    fn pose(index: usize) -> Pose {
        let index = index as f64;
        let eye = Vector3::new(index.cos() * 3.0, index.sin() * 2.0, 0.3 * index);
        Pose::looking_at(eye, Vector3::new(9.0, 1.0, index), Vector3::new(0.0, 0.1, 1.0))
    }

    /// The same cameras in a world of another scale, turned and moved.
    fn moved(pose: &Pose, scale: f64, turn: &Rotation3<f64>, by: Vector3<f64>) -> Pose {
        let rotation = pose.rotation * turn.matrix().transpose();
        let centre = scale * (turn * pose.centre()) + by;
        Pose {
            rotation,
            translation: -(rotation * centre),
        }
    }

    #[test]
    fn a_similarity_is_found_back_and_leaves_nothing() {
        let turn = Rotation3::from_euler_angles(0.3, -1.1, 2.0);
        for scale in [1e-6, 0.5, 1.0, 1e6] {
            let by = Vector3::new(4.0, -2.0, 1.0) * scale;
            let pairs: Vec<(Pose, Pose)> = (0..8)
                .map(|index| (pose(index), moved(&pose(index), scale, &turn, by)))
                .collect();
            let alignment = Alignment::fit(&pairs).unwrap();
            assert!((alignment.scale / scale - 1.0).abs() < 1e-12);
            assert!((alignment.rotation - turn.matrix()).norm() < 1e-12);
            for pair in &pairs {
                let (distance, angle) = alignment.difference(&pair.0, &pair.1);
                assert!(
                    distance < 1e-11 * scale.max(1.0) * 10.0 && angle < 1e-11,
                    "{distance} {angle}"
                );
            }
        }
    }

    #[test]
    fn one_camera_that_turns_by_a_degree_is_off_by_a_degree() {
        let mut pairs: Vec<(Pose, Pose)> = (0..8).map(|index| (pose(index), pose(index))).collect();
        let turn = Rotation3::from_axis_angle(&Vector3::x_axis(), 1_f64.to_radians());
        pairs[3].0.rotation = turn.matrix() * pairs[3].0.rotation;
        pairs[3].0.translation = turn * pairs[3].0.translation;
        let alignment = Alignment::fit(&pairs).unwrap();
        let (distance, angle) = alignment.difference(&pairs[3].0, &pairs[3].1);
        assert!(
            distance < 1e-12 && (angle.to_degrees() - 1.0).abs() < 1e-9,
            "{distance} {angle}"
        );
    }

    #[test]
    fn what_has_no_one_similarity_has_none() {
        let pairs: Vec<(Pose, Pose)> = (0..8).map(|index| (pose(index), pose(index))).collect();
        assert_eq!(Alignment::fit(&pairs[..2]), None);
        assert_eq!(Alignment::fit(&[]), None);
        let on_a_line = |index: usize| {
            let eye = Vector3::new(index as f64, 0.0, 0.0);
            Pose::looking_at(eye, Vector3::new(9.0, 1.0, 3.0), Vector3::new(0.0, 0.1, 1.0))
        };
        let line: Vec<(Pose, Pose)> = (0..8).map(|index| (on_a_line(index), on_a_line(index))).collect();
        assert_eq!(Alignment::fit(&line), None);
        let mut broken = pairs;
        broken[0].0.translation.x = f64::NAN;
        assert_eq!(Alignment::fit(&broken), None);
    }
}

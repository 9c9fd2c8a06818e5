//! Rigid transforms between frames.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// A rigid transform `b_from_a`: x_b = R x_a + t. f64, in the unit of the frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(into = "[[f64; 4]; 3]", from = "[[f64; 4]; 3]")]
pub struct Pose {
    /// R: a proper rotation.
    pub rotation: Matrix3<f64>,
    /// t: the origin of frame a in frame b.
    pub translation: Vector3<f64>,
}

impl Pose {
    /// Returns the identity.
    pub fn identity() -> Self {
        Self {
            rotation: Matrix3::identity(),
            translation: Vector3::zeros(),
        }
    }

    /// Returns the inverse transform, `a_from_b`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }

    /// Transforms a point: R x + t.
    pub fn point(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// Transforms a direction: R d.
    pub fn direction(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * direction
    }

    /// Returns the origin of frame b in frame a, -Rᵀ t. For a `cam_from_world` it is the camera centre in the world.
    pub fn centre(&self) -> Vector3<f64> {
        -(self.rotation.transpose() * self.translation)
    }

    /// Returns the `cam_from_world` (x right, y down, z forward) of a camera at `eye` that looks at `target`.
    ///
    /// `down` need not be orthogonal to the view. If it is parallel to it, another axis is taken.
    pub fn looking_at(eye: Vector3<f64>, target: Vector3<f64>, down: Vector3<f64>) -> Self {
        let forward = (target - eye).try_normalize(1e-300).unwrap_or_else(Vector3::z);
        let sideways = |down: Vector3<f64>| down.cross(&forward).try_normalize(1e-9);
        let right = sideways(down)
            .or_else(|| sideways(Vector3::x()))
            .or_else(|| sideways(Vector3::y()));
        let right = right.unwrap_or_else(Vector3::x);
        let rotation = Matrix3::from_rows(&[
            right.transpose(),
            forward.cross(&right).transpose(),
            forward.transpose(),
        ]);
        Self {
            rotation,
            translation: -(rotation * eye),
        }
    }

    /// Returns whether every number is finite and R is a proper rotation within 1e-4.
    pub fn is_valid(&self) -> bool {
        let finite = self
            .rotation
            .iter()
            .chain(self.translation.iter())
            .all(|value| value.is_finite());
        let defect = (self.rotation * self.rotation.transpose() - Matrix3::identity())
            .abs()
            .max();
        finite && defect < 1e-4 && self.rotation.determinant() > 0.0
    }
}

impl std::ops::Mul for Pose {
    type Output = Self;

    /// Returns the composition: `c_from_b * b_from_a` is `c_from_a`.
    fn mul(self, other: Self) -> Self {
        Self {
            rotation: self.rotation * other.rotation,
            translation: self.point(&other.translation),
        }
    }
}

impl From<Pose> for [[f64; 4]; 3] {
    fn from(pose: Pose) -> Self {
        [0, 1, 2].map(|row| {
            let r = pose.rotation.row(row);
            [r[0], r[1], r[2], pose.translation[row]]
        })
    }
}

impl From<[[f64; 4]; 3]> for Pose {
    fn from(rows: [[f64; 4]; 3]) -> Self {
        Self {
            rotation: Matrix3::from_fn(|row, column| rows[row][column]),
            translation: Vector3::from_fn(|row, _| rows[row][3]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looking_at_puts_the_target_on_the_axis_and_down_below() {
        let eye = Vector3::new(1.0, 2.0, -3.0);
        let target = Vector3::new(5.0, 1.0, -1.0);
        let cam_from_world = Pose::looking_at(eye, target, Vector3::z());
        let seen = cam_from_world.point(&target);
        assert!(
            seen.x.abs() < 1e-12 && seen.y.abs() < 1e-12 && seen.z > 0.0,
            "{seen}"
        );
        assert!(cam_from_world.direction(&Vector3::z()).y > 0.0);
        assert!((cam_from_world.centre() - eye).norm() < 1e-12);
        assert!(cam_from_world.is_valid());
    }

    #[test]
    fn a_pose_and_its_inverse_cancel() {
        let pose = Pose::looking_at(Vector3::new(0.3, -2.0, 9.0), Vector3::zeros(), Vector3::y());
        let both = pose * pose.inverse();
        assert!((both.rotation - Matrix3::identity()).abs().max() < 1e-12);
        assert!(both.translation.norm() < 1e-12);
    }
}

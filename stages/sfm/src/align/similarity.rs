//! Similarity transforms.

use marf_scene::Pose;
use marf_sfm_features::estimators::log_so3;
use nalgebra::{Matrix3, Vector3};

/// A similarity transform: to = scale R from + t.
#[derive(Debug, Clone)]
pub struct Similarity {
    /// Scale, positive.
    pub scale: f64,
    /// R.
    pub rotation: Matrix3<f64>,
    /// t.
    pub translation: Vector3<f64>,
}

impl Similarity {
    /// Returns the transform that changes nothing.
    pub const fn identity() -> Self {
        Self {
            scale: 1.0,
            rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
            translation: Vector3::new(0.0, 0.0, 0.0),
        }
    }

    /// Returns the transform back: from = R^T (to - t) / scale.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self {
            scale: 1.0 / self.scale,
            rotation,
            translation: -(rotation * self.translation) / self.scale,
        }
    }

    /// Returns the transform that does `first`, then this one.
    #[must_use]
    pub fn after(&self, first: &Self) -> Self {
        Self {
            scale: self.scale * first.scale,
            rotation: self.rotation * first.rotation,
            translation: self.point(&first.translation),
        }
    }

    /// Returns the angle of its rotation.
    pub fn angle_rad(&self) -> f64 {
        log_so3(&self.rotation).norm()
    }

    /// Returns the transformed point.
    pub fn point(&self, from: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * from * self.scale + self.translation
    }

    /// Returns `cam_from_to`, in the unit of `to`: the same camera at the transformed centre.
    pub fn pose(&self, cam_from_from: &Pose) -> Pose {
        let rotation = cam_from_from.rotation * self.rotation.transpose();
        Pose {
            rotation,
            translation: cam_from_from.translation * self.scale - rotation * self.translation,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transformed_camera_projects_transformed_points_to_the_same_pixels() {
        for scale in [1e-12, 1.0, 1e12] {
            let similarity = Similarity {
                scale,
                rotation: Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0),
                translation: Vector3::new(3.0, -5.0, 7.0) * scale,
            };
            let camera = Pose::looking_at(Vector3::new(1.0, 2.0, 3.0), Vector3::zeros(), Vector3::y());
            let point = Vector3::new(0.3, -0.2, 0.5);
            let before = camera.point(&point) * scale;
            let after = similarity.pose(&camera).point(&similarity.point(&point));
            assert!(
                (before - after).norm() < 1e-14 * scale * 30.0,
                "{scale}: {before} {after}"
            );
        }
    }
}

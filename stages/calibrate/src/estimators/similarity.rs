//! Scale, turn and shift between two sets of points.

use marf_scene::Pose;
use nalgebra::{Matrix3, Vector3};

/// to = scale R from + t.
#[derive(Debug, Clone)]
pub(crate) struct Similarity {
    pub scale: f64,
    pub rotation: Matrix3<f64>,
    pub translation: Vector3<f64>,
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_carried_camera_sees_carried_points_where_it_saw_them() {
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

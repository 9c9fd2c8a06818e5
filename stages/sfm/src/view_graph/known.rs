//! Edges of the view graph between photos whose cameras and poses are known.

use marf_scene::{Camera, Pose};
use marf_sfm_features::estimators::{essential_of, sampson2};
use marf_sfm_features::features::Features;
use marf_sfm_features::matching::match_pair;
use marf_sfm_features::two_view::{RelativePose, RelativePoseKind};
use nalgebra::Vector2;

use super::view::max_error_px;

/// A photo whose camera and pose are known.
#[derive(Debug, Clone, Copy)]
pub struct KnownView<'a> {
    /// Its features, pixels of the camera's size.
    pub features: &'a Features,
    /// Its camera.
    pub camera: &'a Camera,
    /// Takes points of the world to its camera.
    pub cam_from_world: &'a Pose,
}

/// Returns the relative pose of two photos. It has those of their matches whose Sampson distance from the known epipolar
/// geometry is at most [`max_error_px`]. Photos of one centre have none.
pub fn relate_known(views: [KnownView<'_>; 2]) -> RelativePose {
    let cam2_from_cam1 = *views[1].cam_from_world * views[0].cam_from_world.inverse();
    let essential = essential_of(&cam2_from_cam1);
    let noise2 = views.map(|view| (view.camera.fx_px * view.camera.fy_px).recip());
    let limit_px = max_error_px(views[0].camera).max(max_error_px(views[1].camera));
    let agrees = |features: &[u32; 2]| {
        let planes = [0, 1].map(|side| views[side].plane(features[side]));
        let [Some(first), Some(second)] = planes else {
            return false;
        };
        sampson2(&essential, &[first, second], noise2) <= limit_px * limit_px
    };
    let mut inliers = match_pair(views[0].features, views[1].features);
    inliers.retain(agrees);
    RelativePose {
        kind: RelativePoseKind::General,
        cam2_from_cam1,
        inliers,
        median_angle_rad: 0.0,
        forward: 0.0,
    }
}

impl KnownView<'_> {
    /// Returns the position of a feature in the plane z = 1 in front of the camera.
    fn plane(&self, feature: u32) -> Option<Vector2<f64>> {
        let point = self.features.keypoints.get(feature as usize)?;
        let pixel = Vector2::new(f64::from(point.x_px), f64::from(point.y_px));
        Some(self.camera.unproject(&pixel)?.xy())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_sfm_features::features::Keypoint;
    use nalgebra::Vector3;

    /// Features at these pixels whose descriptors have nothing in common.
    fn features(pixels: &[[f32; 2]]) -> Features {
        let point = |[x_px, y_px]: &[f32; 2]| Keypoint {
            x_px: *x_px,
            y_px: *y_px,
            scale_px: 1.0,
            angle_rad: 0.0,
        };
        let descriptor = |index: usize| {
            let mut descriptor = [0_u8; 128];
            descriptor[4 * index..4 * index + 4].fill(255);
            descriptor
        };
        Features {
            keypoints: pixels.iter().map(point).collect(),
            descriptors: (0..pixels.len()).map(descriptor).collect(),
        }
    }

    fn at(x: f64) -> Pose {
        Pose {
            translation: Vector3::new(-x, 0.0, 0.0),
            ..Pose::identity()
        }
    }

    /// Side by side, so that epipolar lines are rows: 4 of 1,000 pixels are 0.4 of 100, shared by both photos.
    #[test]
    fn matches_stay_whose_rows_agree() {
        let camera = Camera::pinhole(100, 100, 100.0);
        let first = features(&[[50.0, 20.0], [60.0, 40.0], [30.0, 60.0]]);
        let second = features(&[[40.0, 20.0], [50.0, 40.5], [20.0, 60.7]]);
        let relate = |pose: &Pose| {
            let view = |features, cam_from_world| KnownView {
                features,
                camera: &camera,
                cam_from_world,
            };
            relate_known([view(&first, &at(0.0)), view(&second, pose)])
        };
        let found = relate(&at(1.0));
        assert_eq!(found.inliers, [[0, 0], [1, 1]]);
        assert_eq!(found.cam2_from_cam1, at(1.0));
        assert!(relate(&at(0.0)).inliers.is_empty(), "one centre");
        for wrong in [f64::NAN, f64::INFINITY] {
            assert!(relate(&at(wrong)).inliers.is_empty(), "{wrong}");
        }
    }
}

//! The problem of a bundle adjustment: cameras, poses, points, observations and priors.

use marf_scene::{Camera, Pose};
use nalgebra::{Vector2, Vector3};

/// Distortion model, smallest first. The coefficients are those of [`Camera`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum LensModel {
    /// No distortion.
    Pinhole,
    /// k1.
    SimpleRadial,
    /// k1 and k2.
    Radial,
    /// k1, k2, p1 and p2.
    OpenCv,
}

/// The free parameters of a camera. fx and fy vary together (their ratio is fixed). Coefficients that `lens` does not
/// have are fixed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CameraFreedom {
    /// Whether the focal length is free.
    pub focal: bool,
    /// The free distortion coefficients.
    pub lens: LensModel,
    /// Whether the principal point is free.
    pub principal_point: bool,
}

/// Which parameters of a pose are free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PoseFreedom {
    /// All.
    Free,
    /// None.
    Fixed,
    /// All but one coordinate (0, 1, 2) of the camera centre in the world, which fixes the scale.
    CentreAxisFixed(u8),
}

/// A point observed in a photo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Index of the point.
    pub point: u32,
    /// Index of the pose.
    pub pose: u32,
    /// Where it was observed.
    pub pixel: Vector2<f64>,
}

/// Prior knowledge as a residual in units of its sigma, under the loss of priors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Prior {
    /// The camera centre in the world.
    Centre {
        /// Index of the pose.
        pose: u32,
        /// The expected centre.
        centre: Vector3<f64>,
        /// Standard deviation of the centre, unit of the world.
        sigma: f64,
    },
    /// The attitude of a camera: the rotation of `cam_from_world`.
    Attitude {
        /// Index of the pose.
        pose: u32,
        /// The expected pose. Only its rotation counts.
        cam_from_world: Pose,
        /// Standard deviation of the attitude.
        sigma_rad: f64,
    },
    /// The pose of one camera in the frame of another (a rigid stereo pair).
    Relative {
        /// Index of the first pose.
        pose_1: u32,
        /// Index of the second pose.
        pose_2: u32,
        /// The expected relative pose.
        cam2_from_cam1: Pose,
        /// Standard deviation of the attitude.
        sigma_rad: f64,
        /// Standard deviation of the centre, unit of the world.
        sigma: f64,
    },
    /// The focal length of a camera (fx). The residual is ln(f / focal_px) / sigma_share.
    Focal {
        /// Index of the camera.
        camera: u32,
        /// The expected focal length.
        focal_px: f64,
        /// Standard deviation as a fraction of the focal length.
        sigma_share: f64,
    },
}

/// What is adjusted together. Observations are sorted by (point, pose).
#[derive(Debug, Clone, Default)]
pub struct Problem {
    /// Lenses that photos share.
    pub cameras: Vec<Camera>,
    /// Free parameters of each camera.
    pub camera_freedom: Vec<CameraFreedom>,
    /// `cam_from_world` of each photo.
    pub poses: Vec<Pose>,
    /// Free parameters of each pose.
    pub pose_freedom: Vec<PoseFreedom>,
    /// Index of each pose's camera.
    pub camera_of_pose: Vec<u32>,
    /// In the world.
    pub points: Vec<Vector3<f64>>,
    /// Sorted by (point, pose).
    pub observations: Vec<Observation>,
    /// In any order.
    pub priors: Vec<Prior>,
}

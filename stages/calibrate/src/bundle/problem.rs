//! What is adjusted: poses, points, lenses, what was seen of them and what was known before.

use marf_scene::{Camera, Pose};
use nalgebra::{Vector2, Vector3};

/// Lens terms beside the focal length, smallest first: none; k1; k1 k2; k1 k2 p1 p2 ([`Camera`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum LensModel {
    Pinhole,
    SimpleRadial,
    Radial,
    OpenCv,
}

/// Which numbers of a camera may move. fx and fy move together (their ratio stays); the terms above `lens` stay
/// as they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CameraFreedom {
    pub focal: bool,
    pub lens: LensModel,
    pub principal_point: bool,
}

/// How a pose may move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PoseFreedom {
    Free,
    /// Held whole.
    Fixed,
    /// One coordinate (0, 1, 2) of the camera's centre in the world is held, which fixes the scale.
    CentreAxisFixed(u8),
}

/// A point seen by a photo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Observation {
    /// Index of the point.
    pub point: u32,
    /// Index of the pose.
    pub pose: u32,
    pub pixel: Vector2<f64>,
}

/// Something known beforehand, as a soft residual in units of its sigma, held in check by the loss of priors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Prior {
    /// The camera's centre in the world.
    Centre {
        pose: u32,
        centre: Vector3<f64>,
        sigma: f64,
    },
    /// The camera's attitude (of `cam_from_world`, its rotation).
    Attitude {
        pose: u32,
        cam_from_world: Pose,
        sigma_rad: f64,
    },
    /// Pose of one camera in another's frame (fixed stereo eyes).
    Relative {
        pose_1: u32,
        pose_2: u32,
        cam2_from_cam1: Pose,
        sigma_rad: f64,
        sigma: f64,
    },
    /// The camera's focal length (fx); sigma as a share of it, residual ln(f / focal_px) / sigma_share.
    Focal {
        camera: u32,
        focal_px: f64,
        sigma_share: f64,
    },
}

/// All that is adjusted together. Observations are sorted by (point, pose).
#[derive(Debug, Clone, Default)]
pub(crate) struct Problem {
    pub cameras: Vec<Camera>,
    pub camera_freedom: Vec<CameraFreedom>,
    /// `cam_from_world`.
    pub poses: Vec<Pose>,
    pub pose_freedom: Vec<PoseFreedom>,
    /// Index of each pose's camera.
    pub camera_of_pose: Vec<u32>,
    pub points: Vec<Vector3<f64>>,
    pub observations: Vec<Observation>,
    pub priors: Vec<Prior>,
}

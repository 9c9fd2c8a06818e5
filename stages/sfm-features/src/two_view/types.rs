//! Inputs and results of verification and of relative pose estimation.

use marf_scene::{Camera, Pose};
use nalgebra::{Matrix3, Vector2};
use serde::{Deserialize, Serialize};

/// Options of geometric verification.
#[derive(Debug, Clone)]
pub struct VerifyOptions {
    /// Largest Sampson error of an inlier, pixels: 4 at a longer side of 1000.
    pub max_error_px: f64,
    /// Smallest number of inliers of a verified pair. More are required if this number may agree by chance.
    pub min_inliers: u32,
}

/// The camera of a photo (its focal length may be a guess) and the positions of its features.
#[derive(Debug, Clone, Copy)]
pub struct ViewPoints<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// Positions of the features, pixels.
    pub pixels: &'a [Vector2<f64>],
}

/// Whether focal lengths are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FocalKnown {
    /// From a label or from EXIF.
    Known,
    /// A guess.
    Guessed,
}

/// Kind of geometry that explains the matches of a pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum VerifiedKind {
    /// A scene with depth.
    General,
    /// A plane or a pure rotation: a homography explains more than 0.8 of the inliers.
    Planar,
    /// Objects fixed to the camera, or the same image twice: at least 0.8 of the inliers do not move.
    Stationary,
    /// No more inliers than expected by chance.
    None,
}

/// Matches of a pair of photos after geometric verification.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct VerifiedPair {
    /// Inlier matches in the given order, one for each pair of positions.
    pub inliers: Vec<[u32; 2]>,
    /// Fundamental matrix: x2ᵀ F x1 = 0 in undistorted pixels, unit norm.
    pub fundamental: Option<Matrix3<f64>>,
    /// Kind of geometry.
    pub kind: VerifiedKind,
}

/// Kind of geometry that a relative pose was estimated from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum RelativePoseKind {
    /// A scene with depth.
    General,
    /// A plane.
    Planar,
    /// A pure rotation: no baseline.
    Rotation,
}

/// The relative pose of two photos.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RelativePose {
    /// What it was estimated from.
    pub kind: RelativePoseKind,
    /// The pose, with translation of unit length, zero for `Rotation`.
    pub cam2_from_cam1: Pose,
    /// Inlier matches in the given order, one for each pair of positions.
    pub inliers: Vec<[u32; 2]>,
    /// Median triangulation angle of the inliers.
    pub median_angle_rad: f64,
    /// |t·z| of the unit translation t: the part of the motion along the optical axis; 0 for `Rotation`.
    pub forward: f64,
}

//! What two photos say about each other: one rigid scene, a plane, a turn on the spot, or nothing.
//!
//! `verify` judges raw matches, `focal_from_pairs` finds a focal length that many pairs share, `relate`
//! turns verified matches into a relative pose. All counts are of distinct spots: two features at one pixel
//! are one witness.

mod focal;
mod judge;
mod relate;
mod spots;
mod still;
mod verify;

#[cfg(test)]
mod tests;

use marf_scene::{Camera, Pose};
use nalgebra::{Matrix3, Vector2};

pub(crate) use {focal::focal_from_pairs, relate::relate, verify::verify};

/// When matches count as verified.
#[derive(Debug, Clone)]
pub(crate) struct VerifyOptions {
    /// Largest Sampson error of an inlier, pixels: 4 at a longer side of 1000.
    pub max_error_px: f64,
    /// Fewest inliers of a verified pair; more are asked for where so many may agree by chance.
    pub min_inliers: u32,
    /// Samples of seven points at most; of five and of four a quarter of it.
    pub max_trials: u32,
    /// Chance wanted of one clean sample.
    pub confidence: f64,
}

impl Default for VerifyOptions {
    fn default() -> Self {
        Self {
            max_error_px: 4.0,
            min_inliers: 15,
            max_trials: 2000,
            confidence: 0.999,
        }
    }
}

/// A photo's camera (its focal length may be a guess) and the pixels of its features.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ViewPoints<'a> {
    pub camera: &'a Camera,
    pub pixels: &'a [Vector2<f64>],
}

/// Whether both focal lengths can be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FocalKnown {
    Known,
    Guessed,
}

/// What explains the matches of a pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum VerifiedKind {
    /// A scene with depth.
    General,
    /// A plane or a turn on the spot: a homography explains more than .8.
    Planar,
    /// Things that move with the camera, or the same picture twice: at least .8 do not move.
    Stationary,
    /// Nothing beyond chance.
    None,
}

/// The verdict on a pair's matches.
#[derive(Debug, Clone)]
pub(crate) struct Verified {
    /// Matches that agree, in the order given, one per pair of pixels.
    pub inliers: Vec<[u32; 2]>,
    /// x2ᵀ F x1 = 0 in pixels of the ideal pinholes (distortion removed with the cameras' own
    /// coefficients), unit norm.
    pub fundamental: Option<Matrix3<f64>>,
    pub fundamental_inliers: u32,
    pub essential_inliers: u32,
    pub homography_inliers: u32,
    pub kind: VerifiedKind,
}

/// What a pair's relative pose rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RelationKind {
    General,
    Planar,
    Rotation,
}

/// The relative pose of two photos.
#[derive(Debug, Clone)]
pub(crate) struct Relation {
    pub kind: RelationKind,
    /// Unit translation; zero for `Rotation`.
    pub cam2_from_cam1: Pose,
    /// Matches that agree, in the order given, one per pair of pixels.
    pub inliers: Vec<[u32; 2]>,
    /// Median angle between the two rays of an inlier.
    pub median_angle_rad: f64,
    /// |t·z| of the unit translation; 0 for `Rotation`.
    pub forward: f64,
}

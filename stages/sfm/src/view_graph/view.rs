//! Photos, their cameras, and the pairs and edges of the view graph.

use marf_scene::{Camera, Pose};
use marf_sfm_features::two_view::{FocalKnown, RelativePose, VerifiedPair};
use nalgebra::Vector2;

/// Camera and features of a photo.
#[derive(Debug, Clone)]
pub struct View {
    /// Index of its camera.
    pub camera: usize,
    /// Features, pixels of the working size.
    pub pixels: Vec<Vector2<f64>>,
}

/// A camera with its pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosedCamera {
    /// The camera.
    pub camera: Camera,
    /// Takes points of the world to the camera.
    pub cam_from_world: Pose,
}

/// A camera that photos share, as known before mapping.
#[derive(Debug, Clone)]
pub struct SharedCamera {
    /// Initial parameters.
    pub camera: Camera,
    /// Whether the focal length is known.
    pub focal: FocalKnown,
    /// Standard deviation of the focal length as a fraction of it. `None` for a guess.
    pub focal_sigma_share: Option<f64>,
}

/// An edge of the view graph: two photos of the same rigid scene, the lower index first.
#[derive(Debug, Clone)]
pub struct Link {
    /// Indices of the photos.
    pub photos: [usize; 2],
    /// Their relative pose and its inliers.
    pub relative_pose: RelativePose,
}

/// A pair of photos whose features were matched and verified.
#[derive(Debug, Clone)]
pub struct ComparedPair {
    /// Indices of the photos, the lower first.
    pub photos: [usize; 2],
    /// The verified matches.
    pub verified: VerifiedPair,
}

/// Largest reprojection error of an inlier for a photo of 1000 px.
const MAX_ERROR_PX: f64 = 4.0;

/// Returns the largest reprojection error of an inlier: 4 px for a longer side of 1000 px.
pub fn max_error_px(camera: &Camera) -> f64 {
    MAX_ERROR_PX * f64::from(camera.width.max(camera.height)) / 1000.0
}

/// Whether the focal lengths of both photos are known.
pub fn focal_known(views: &[View], cameras: &[SharedCamera], photos: [usize; 2]) -> FocalKnown {
    let guessed = |&photo: &usize| cameras[views[photo].camera].focal == FocalKnown::Guessed;
    if photos.iter().any(guessed) {
        FocalKnown::Guessed
    } else {
        FocalKnown::Known
    }
}

//! Matches in the image plane with their noise.

use crate::estimators::PointPair;

/// Correspondences in the image plane, the size of a pixel there, and the largest error of an inlier.
pub(super) struct RayMatches<'a> {
    /// Undistorted, at z = 1.
    pub pairs: &'a [PointPair],
    /// Squared size of a pixel in the image planes of photo 1 and 2.
    pub noise2: [f64; 2],
    /// Pixels.
    pub limit: f64,
}

//! Points that can be found again in another photo: SIFT.
//!
//! A pure function of one photo's pixels, its mask and the options. Invariant: keypoints are sorted by octave,
//! layer, row and column, and are equal to the bit for any instruction set.

use serde::{Deserialize, Serialize};

/// A point found in a photo, in pixels of the working size; (0, 0) is the top-left corner.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Keypoint {
    pub x_px: f32,
    pub y_px: f32,
    /// Standard deviation of the Gaussian it was found at, pixels of the working size.
    pub scale_px: f32,
    /// Direction of the strongest gradient, from x towards y.
    pub angle_rad: f32,
}

/// RootSIFT in 8 bits: 4 x 4 cells of 8 directions.
pub(crate) type Descriptor = [u8; 128];

/// What is found in one photo; both lists have one length.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Features {
    pub keypoints: Vec<Keypoint>,
    pub descriptors: Vec<Descriptor>,
}

//! Keypoints and descriptors.

/// Position, scale and orientation of a feature, in pixels of the working size. (0, 0) is the top-left corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Column.
    pub x_px: f32,
    /// Row.
    pub y_px: f32,
    /// Standard deviation of the Gaussian it was found at, pixels of the working size.
    pub scale_px: f32,
    /// Dominant gradient direction, from x towards y.
    pub angle_rad: f32,
}

/// RootSIFT in 8 bits: 4 x 4 cells of 8 gradient directions.
pub type Descriptor = [u8; 128];

/// Features of one photo. Both lists have the same length.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Features {
    /// Where each feature is.
    pub keypoints: Vec<Keypoint>,
    /// The descriptor of each feature.
    pub descriptors: Vec<Descriptor>,
}

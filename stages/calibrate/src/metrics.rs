//! The output `metrics`.

use serde::{Deserialize, Serialize};

/// Result of each photo; the output `metrics`, as JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// The method, in a sentence.
    pub method: String,
    /// Sums.
    pub totals: Totals,
    /// One entry for each photo of the input, sorted by id.
    pub photos: Vec<PhotoMetrics>,
    /// Files the import has a camera for that are not among the photos, sorted by name.
    pub missing: Vec<Missing>,
}

/// Sums over all photos.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Totals {
    /// Photos of the input.
    pub photos: usize,
    /// Photos with a camera.
    pub registered: usize,
    /// Photos with a camera that are kept from training.
    pub held_out: usize,
    /// Photos without a camera.
    pub unplaced: usize,
    /// Files with a camera that are not among the photos.
    pub missing: usize,
    /// Sparse points.
    pub points: usize,
    /// Connected components of photos, that of the scene included, if the method knows them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub components: Option<usize>,
    /// Mean over the photos that have one of their mean reprojection error, pixels.
    pub error_px: Option<f64>,
    /// The same at the size at which features were sought, pixels; `sfm` only.
    pub error_working_px: Option<f64>,
}

/// Result of one photo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhotoMetrics {
    /// Its id.
    pub id: String,
    /// Its file.
    pub file: String,
    /// Whether it has a camera.
    pub registered: bool,
    /// Whether it is kept from training.
    pub held_out: bool,
    /// Features found in it, if the method knows.
    pub features: Option<u32>,
    /// Features that match those of another photo, if the method knows.
    pub matches: Option<u32>,
    /// Features that belong to a point of the scene, if the method knows.
    pub inliers: Option<u32>,
    /// Mean reprojection error of those features, pixels of its camera.
    pub error_px: Option<f64>,
    /// Standard deviation of its attitude relative to the scene's first photo, degrees; `sfm` only.
    pub angle_sigma_deg: Option<f64>,
    /// Standard deviation of its centre, likewise, in the scene's unit; `sfm` only.
    pub centre_sigma: Option<f64>,
    /// A remark (a label that disagrees with the photos).
    pub note: Option<String>,
    /// Why it has no camera; empty if it has.
    pub reason: String,
}

/// A file with a camera that is not among the photos.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Missing {
    /// Its name in the import.
    pub file: String,
    /// Why it is not in the scene.
    pub reason: String,
}

//! How well a field reproduces photos, as part of the metrics of `train` and `evaluate`.

use marf_scene::Nearest;
use serde::{Deserialize, Serialize};

/// How well one photo is reproduced.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhotoScores {
    /// Id of the photo.
    pub id: String,
    /// Its file.
    pub file: String,
    /// Name of its pictures (`heldout/<name>.png`, `photo/<name>.png`).
    pub name: String,
    /// Peak signal-to-noise ratio, peak 1, dB. At most 100, the value of equal pictures.
    pub psnr: f64,
    /// PSNR after gain and offset of each channel were fitted to the photo, dB. Only if the photos trained on have exposures of their own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr_affine: Option<f64>,
    /// The paper's definition, peak = largest value of the photo, dB. `None` for a black photo.
    pub psnr_paper: Option<f64>,
    /// Structural similarity, at most 1. `None` for a photo smaller than its window of 11 pixels.
    pub ssim: Option<f64>,
    /// Its distance from the photos trained on. `None` for one of these.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nearest: Option<Nearest>,
}

/// Means over photos that look where no photo trained on does, and over the others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Apart {
    /// Photos that do ([`Nearest::extrapolates`]).
    pub extrapolated: u64,
    /// Mean of their PSNR, dB.
    pub psnr_extrapolated: f64,
    /// Mean PSNR of the others, dB. `None` if all extrapolate.
    pub psnr_others: Option<f64>,
}

/// Means over photos, and each photo's own.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// Mean of [`PhotoScores::psnr`], dB.
    pub psnr: f64,
    /// Mean of [`PhotoScores::psnr_affine`], dB. Photos are not judged by it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr_affine: Option<f64>,
    /// Mean of [`PhotoScores::psnr_paper`] over the photos that have one, dB.
    pub psnr_paper: Option<f64>,
    /// Mean of [`PhotoScores::ssim`] over the photos that have one.
    pub ssim: Option<f64>,
    /// Separate PSNR of photos that look where no photo trained on does. `None` if no photo does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub apart: Option<Apart>,
    /// Every photo.
    pub views: Vec<PhotoScores>,
}

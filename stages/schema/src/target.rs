//! A quality that a training stops at, and how it went.

use serde::{Deserialize, Serialize};

/// How a training with `target_psnr` ended. The photos held out have no part in it: they are judged once, afterwards.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// Requested mean PSNR, dB.
    pub psnr: f64,
    /// Steps after which the validation photos had it. `None`: missed, and the training ended as planned.
    pub reached_at: Option<u64>,
    /// Mean PSNR on all validation photos at the end, dB.
    pub validation_psnr: f64,
    /// Training photos held back to watch it by, whole places, about one in eight.
    pub validation_photos: u64,
    /// The forecast when the target first seemed out of reach. `None` if it never did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub forecast: Option<Forecast>,
}

/// Forecast of the end of a training from its curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Forecast {
    /// Steps that had been taken.
    pub at: u64,
    /// Mean PSNR on the validation photos at the end, dB.
    pub psnr: f64,
}

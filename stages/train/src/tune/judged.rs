use marf_schema::{partial::Reached, train::Metrics};

/// How a trial was judged: by the photos of its training, or by shrunk ones on its way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Judged {
    /// Optimiser steps that it had taken.
    pub steps: u64,
    /// Mean PSNR, dB.
    pub psnr: f64,
    /// The paper's definition.
    pub psnr_paper: Option<f64>,
    /// Mean SSIM.
    pub ssim: Option<f64>,
    /// Photos that it was judged by.
    pub photos: u64,
    /// Longest side of these, where they were shrunk for it, pixels.
    pub judged_px: Option<u32>,
}

impl From<Metrics> for Judged {
    fn from(metrics: Metrics) -> Self {
        Self {
            steps: metrics.steps,
            psnr: metrics.scores.psnr,
            psnr_paper: metrics.scores.psnr_paper,
            ssim: metrics.scores.ssim,
            photos: metrics.held_out_photos,
            judged_px: None,
        }
    }
}

impl From<Reached> for Judged {
    fn from(reached: Reached) -> Self {
        Self {
            steps: reached.until,
            psnr: reached.psnr,
            psnr_paper: None,
            ssim: None,
            photos: reached.held_out_photos,
            judged_px: Some(reached.judged_px),
        }
    }
}

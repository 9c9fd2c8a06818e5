use marf_schema::{partial::Reached, train::Metrics, tune::TuneParams};
use marf_stage::{Ctx, Outputs, StageError};

use crate::child::Child;

/// How all trials came out, and what another seed changes.
#[derive(Debug, Clone)]
pub(super) struct Standing {
    /// How each trial was judged last, by number.
    pub judged: Vec<TrialScore>,
    /// The defaults with another seed.
    pub other_seed: TrialScore,
    /// The best trial with another seed, if it was run.
    pub best_with_other_seed: Option<TrialScore>,
}

impl Standing {
    /// Reads the best trial with another seed from what came behind all else.
    ///
    /// # Errors
    /// More than one node, an output that cannot be read.
    pub fn new(
        ctx: &Ctx<'_>,
        params: &TuneParams,
        judged: Vec<TrialScore>,
        other_seed: TrialScore,
        rest: &[Outputs],
    ) -> Result<Self, StageError> {
        let best_with_other_seed = match rest {
            [] => None,
            [outputs] => {
                let name = "the best trial with another seed".to_owned();
                Some(Child { name, outputs }.read::<Metrics>(ctx)?.into())
            }
            _ => return Err(miscounted(params, judged.len() + 1 + rest.len())),
        };
        Ok(Self {
            judged,
            other_seed,
            best_with_other_seed,
        })
    }

    /// Returns the best trial of those that went furthest. Of equals the first is taken.
    pub fn best(&self) -> u32 {
        self.ranking().first().map_or(0, |best| *best as u32)
    }

    /// Returns the numbers of all trials: those that went further come first, then those with the better PSNR.
    pub fn ranking(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.judged.len()).collect();
        order.sort_by(|&a, &b| {
            let (first, second) = (&self.judged[a], &self.judged[b]);
            let further = second.steps.cmp(&first.steps);
            further.then(second.psnr.total_cmp(&first.psnr)).then(a.cmp(&b))
        });
        order
    }
}

/// Returns the error of outputs that do not belong to the planned nodes.
pub(super) fn miscounted(params: &TuneParams, came: usize) -> StageError {
    StageError::new(format!(
        "expected the outputs of {} trials and the scatter, got {came}",
        params.trials
    ))
}

/// How a trial was judged: by whole photos, or by some of their pixels on its way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TrialScore {
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
    /// Longest side of the grid of pixels of each, if these were not all.
    pub judged_px: Option<u32>,
}

impl From<Metrics> for TrialScore {
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

impl From<Reached> for TrialScore {
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

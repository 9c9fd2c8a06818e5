//! A verdict as a score against a threshold.

use marf_stage::Verdict;

/// Thresholds that are tried, as multiples of those in force.
pub const FACTORS: [f64; 6] = [0.8, 0.9, 0.95, 1.05, 1.1, 1.2];

/// A verdict that rests on a score and a threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Call {
    keeps: bool,
    score: f64,
    threshold: f64,
}

impl Call {
    /// Reads it from a verdict. `None` without a score or threshold, or if a person has decided.
    pub fn from_verdict(verdict: &Verdict) -> Option<Self> {
        let manual =
            verdict.reason.starts_with("kept by hand") || verdict.reason.starts_with("rejected by hand");
        let call = Self {
            keeps: verdict.keeps(),
            score: verdict.score?,
            threshold: verdict.threshold?,
        };
        let sound = call.score.is_finite() && call.threshold.is_finite() && call.threshold != 0.0;
        (sound && !manual).then_some(call)
    }

    /// Returns how far the score is above the threshold, as a share of it. Negative below.
    pub fn margin(&self) -> f64 {
        (self.score - self.threshold) / self.threshold.abs()
    }

    /// Returns true if the verdict would change with `factor` times the threshold. Only this score counts:
    /// other measures of the filter stay as they are.
    pub fn flips_at(&self, factor: f64) -> bool {
        // The side on which photos go: where a rejected one is, and a kept one is not.
        let high_goes = (self.score >= self.threshold) != self.keeps;
        let threshold = self.threshold * factor;
        let is_above = self.score >= threshold;
        let goes = is_above == high_goes;
        goes == self.keeps
    }
}

/// Returns the calls among some verdicts.
pub fn calls(verdicts: &[Verdict]) -> Vec<Call> {
    verdicts.iter().filter_map(Call::from_verdict).collect()
}

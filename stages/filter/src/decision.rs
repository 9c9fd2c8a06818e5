//! What a filter says of one photo.

use marf_cache::manifest::Row;
use marf_stage::Verdict;

use crate::facts::Facts;

/// Verdict of a photo whose bytes cannot be decoded here.
pub const DECODE: &str = "decode";

/// Whether a filter keeps a photo, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// Whether the photo is kept.
    pub keep: bool,
    /// The number that was compared with the threshold, in the filter's own unit.
    pub score: Option<f64>,
    /// The threshold.
    pub threshold: Option<f64>,
    /// Of a duplicate, the photo that is kept instead.
    pub twin: Option<String>,
    /// One sentence. May be empty for a kept photo.
    pub reason: String,
}

impl Decision {
    /// Returns the decision to keep a photo whose `score` satisfies `threshold`.
    pub fn keep(score: f64, threshold: f64) -> Self {
        Self {
            keep: true,
            ..Self::reject(score, threshold, String::new())
        }
    }

    /// Returns the decision to keep a photo that was compared with no threshold, and why.
    pub fn pass(reason: impl Into<String>) -> Self {
        Self {
            keep: true,
            score: None,
            threshold: None,
            twin: None,
            reason: reason.into(),
        }
    }

    /// Returns the decision to reject a photo.
    pub fn reject(score: f64, threshold: f64, reason: impl Into<String>) -> Self {
        Self {
            keep: false,
            score: Some(score),
            threshold: Some(threshold),
            twin: None,
            reason: reason.into(),
        }
    }

    /// Returns the decision as the verdict of filter `name` on the photo of `row`.
    pub(crate) fn verdict(self, name: &str, row: &Row, facts: &Facts<'_>) -> Verdict {
        Verdict {
            id: row.id.clone(),
            file: file_of(row, facts),
            verdict: if self.keep { Verdict::KEEP } else { name }.to_owned(),
            score: self.score,
            threshold: self.threshold,
            twin: self.twin,
            reason: self.reason,
        }
    }
}

/// Returns the file a photo came from, or its id where no file is known.
fn file_of(row: &Row, facts: &Facts<'_>) -> String {
    match facts.file {
        "" => row.id.clone(),
        file => file.to_owned(),
    }
}

/// Returns the verdict of a photo that could not be decoded.
pub(crate) fn undecodable(row: &Row, facts: &Facts<'_>, reason: String) -> Verdict {
    let decision = Decision {
        keep: false,
        ..Decision::pass(reason)
    };
    decision.verdict(DECODE, row, facts)
}

//! The rules of `duplicate` and their parameters.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::candidates::Search;
use crate::decision::Decision;
use crate::relation::Relation;

/// Rejects photos that show the same view as a better one, at any size, light and colour filter.
///
/// The better photo is, in this order: kept by hand, broad-band, in colour, calibrated radiance of several versions
/// of an exposure, sharper, larger, of the smaller id. A photo is rejected only if it is similar to a kept one, so
/// some of a chain of neighbours are always kept. A photo of an earlier sol is preferred to one of a later sol.
pub struct Duplicate {
    pub(super) params: DuplicateParams,
}

/// The rule of [`Duplicate`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DuplicateRule {
    /// Perceptual hash for candidates, correlation of gradients as proof: stereo partners and video neighbours
    /// are kept.
    Confirmed,
    /// The paper's rule: perceptual hashes of brightness closer than `max_bits`.
    Phash,
}

/// Parameters of [`Duplicate`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DuplicateParams {
    /// `confirmed` (default) or `phash` (the paper).
    pub rule: DuplicateRule,
    /// Largest distance of the 64-bit hashes of two candidates, over pairs of bands, in bits.
    pub candidate_bits: u32,
    /// Smallest correlation of the gradient images of two duplicates. Copies reach 0.99, video
    /// neighbours 0.94, stereo partners 0.87.
    pub min_correlation: f64,
    /// The same for one view through different colour filters, by name or label. If only camera, sol and
    /// filter are known: the mean of this and `min_correlation`.
    pub filter_correlation: f64,
    /// The same for two versions of one exposure by name (EFF, RAD, RSL). It is low, because it only guards
    /// against wrong names.
    pub version_correlation: f64,
    /// Hashes closer than this many bits are duplicates, for `rule = "phash"`.
    pub max_bits: u32,
    /// Photos kept or rejected by hand, filled from `[keep]` and `[reject]` of the pipeline.
    pub by_hand: ByHand,
}

impl Default for DuplicateParams {
    fn default() -> Self {
        Self {
            rule: DuplicateRule::Confirmed,
            candidate_bits: 14,
            min_correlation: 0.975,
            filter_correlation: 0.8,
            version_correlation: 0.5,
            max_bits: 5,
            by_hand: ByHand::default(),
        }
    }
}

impl Duplicate {
    /// Returns the search of hashes that the rule needs.
    pub(super) fn search(&self) -> Search {
        match self.params.rule {
            DuplicateRule::Confirmed => Search::Within(self.params.candidate_bits),
            DuplicateRule::Phash => Search::Nearest,
        }
    }

    /// Returns the smallest correlation of two duplicates that are related like this.
    pub(super) fn min_correlation(&self, relation: Relation) -> f64 {
        let (usual, filter) = (self.params.min_correlation, self.params.filter_correlation);
        let limit = match relation {
            Relation::SameExposure => self.params.version_correlation,
            Relation::SamePointing => filter,
            Relation::SameCamera => (usual + filter) / 2.0,
            Relation::Unknown => usual,
        };
        limit.min(usual)
    }

    /// Decides by the distance of the hashes of brightness alone.
    pub(super) fn compare_hashes(&self, bits: u32, other: &str) -> Decision {
        let limit = self.params.max_bits;
        let (score, threshold) = (f64::from(bits), f64::from(limit));
        let reason = || format!("like `{other}`: hashes {bits} bits apart, less than {limit}");
        compared(bits < limit, score, threshold, reason, other)
    }
}

/// Returns the decision on a photo that was compared with `other`.
pub(super) fn compared(
    alike: bool,
    score: f64,
    limit: f64,
    reason: impl Fn() -> String,
    other: &str,
) -> Decision {
    if !alike {
        return Decision {
            reason: format!("nearest is `{other}`"),
            ..Decision::keep(score, limit)
        };
    }
    Decision {
        twin: Some(other.to_owned()),
        ..Decision::reject(score, limit, reason())
    }
}

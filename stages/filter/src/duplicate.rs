//! The filter `duplicate`.

mod fold;
mod nearest;
mod photo;

use marf_cache::{Digest, manifest::Row};
use marf_stage::{Ctx, Define, Fold, FoldState, Measure, ParamError, Port, Stage, StageError, Table, Work};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::decision::Decision;
use crate::descriptor::ViewDescriptor;
use crate::filter::check_range;
#[cfg(test)]
use crate::guard::Guard;
use crate::index::Search;
use crate::relation::Relation;
use crate::stage::{OUTPUTS, PORTS};
use crate::survey::{Section, Surveyed, measure_row, tables};
use fold::KeptPhotos;

/// Rejects photos that show the same view as a better one, whatever their size, light and colour filter.
///
/// The better photo is, in this order: kept by hand, broad-band, in colour, calibrated radiance of several versions of
/// an exposure, sharper, larger, of the smaller id. A photo is rejected only if it is similar to one that is kept, so of
/// a chain of neighbours some are always kept; a photo of an earlier sol is preferred to one of a later sol.
pub struct Duplicate {
    params: DuplicateParams,
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
    /// The same for one pointing through different colour filters, by name or label. Where only camera, sol and filter
    /// are known, the mean of this and `min_correlation`.
    pub filter_correlation: f64,
    /// The same for two versions of one exposure by name (EFF, RAD, RSL): low, it only guards against wrong names.
    pub version_correlation: f64,
    /// Hashes closer than this many bits are duplicates, for `rule = "phash"`.
    pub max_bits: u32,
    /// Photos kept or rejected by hand; filled from `[keep]` and `[reject]` of the pipeline.
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

impl Define for Duplicate {
    type Params = DuplicateParams;
    const NAME: &'static str = "duplicate";
    const ABOUT: &'static str = "rejects photos that show the same view as a better one";
    const VERSION: u32 = Self::MEASURE_VERSION + Self::DECISION_VERSION;
    const RELAX: Option<&'static str> = Some("a higher `min_correlation`");
    const PORTS: &'static [Port] = PORTS;
    const OUTPUTS: &'static [&'static str] = OUTPUTS;

    fn new(params: DuplicateParams) -> Result<Self, ParamError> {
        check_range("candidate_bits", f64::from(params.candidate_bits), 0.0, 64.0)?;
        check_range("max_bits", f64::from(params.max_bits), 0.0, 65.0)?;
        check_range("min_correlation", params.min_correlation, -1.0, 1.0)?;
        check_range("filter_correlation", params.filter_correlation, -1.0, 1.0)?;
        check_range("version_correlation", params.version_correlation, -1.0, 1.0)?;
        params.by_hand.check()?;
        Ok(Self { params })
    }
}

impl Stage for Duplicate {
    fn params(&self) -> serde_json::Value {
        marf_stage::key_params(&self.params, &[])
    }

    fn work(&self) -> Work<'_> {
        Work::Fold(self)
    }
}

impl Surveyed for Duplicate {
    const SECTION: Option<Section> = Some(Section {
        table: Self::TABLE,
        measure: |ctx, photo| {
            let (descriptor, planes) = ViewDescriptor::of(photo);
            ctx.put(&planes)?;
            Ok(descriptor.encode())
        },
    });
    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "3 9b0277c7e112",
        decisions: "3 8a7685578a5e",
    };
}

impl Measure for Duplicate {
    fn table(&self) -> Option<Table> {
        Some(Self::TABLE)
    }

    fn together(&self) -> Vec<Table> {
        tables()
    }

    fn measure(&self, ctx: &Ctx<'_>, row: &Row, wanted: &[Table]) -> Result<Vec<Vec<u8>>, StageError> {
        measure_row(ctx, row, wanted)
    }

    /// Returns the gradient planes that a [`ViewDescriptor`] names.
    fn blobs(&self, measure: &[u8]) -> Vec<Digest> {
        let descriptor = measure.get(1..).and_then(ViewDescriptor::decode);
        descriptor
            .map(|descriptor| descriptor.planes)
            .into_iter()
            .collect()
    }
}

impl Fold for Duplicate {
    fn begin(&self) -> Box<dyn FoldState + '_> {
        Box::new(KeptPhotos::new(self))
    }
}

impl Duplicate {
    /// As [`Filter::MEASURE_VERSION`](crate::Filter::MEASURE_VERSION).
    const MEASURE_VERSION: u32 = 3;
    /// As [`Filter::DECISION_VERSION`](crate::Filter::DECISION_VERSION).
    const DECISION_VERSION: u32 = 0;

    /// Where its measures are kept.
    const TABLE: Table = Table {
        name: Self::NAME,
        version: Self::MEASURE_VERSION,
    };

    /// Returns what the rule asks of the hashes.
    fn search(&self) -> Search {
        match self.params.rule {
            DuplicateRule::Confirmed => Search::Within(self.params.candidate_bits),
            DuplicateRule::Phash => Search::Nearest,
        }
    }

    /// Returns the smallest correlation of two duplicates that are related like this.
    fn min_correlation(&self, relation: Relation) -> f64 {
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
    fn compare_hashes(&self, bits: u32, other: &str) -> Decision {
        let limit = self.params.max_bits;
        let (score, threshold) = (f64::from(bits), f64::from(limit));
        let reason = || format!("like `{other}`: hashes {bits} bits apart, less than {limit}");
        compared(bits < limit, score, threshold, reason, other)
    }
}

/// Returns the decision on a photo that was compared with `other`.
fn compared(alike: bool, score: f64, limit: f64, reason: impl Fn() -> String, other: &str) -> Decision {
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

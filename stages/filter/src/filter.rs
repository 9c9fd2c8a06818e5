//! What a filter is: a measure of one photo, and a decision by thresholds.

use marf_cache::{ContentHash, manifest::Row};
use marf_scene::PhotoFacts;
use marf_stage::{ParamError, StageError, Verdict};
use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};

use crate::by_hand::ByHand;
use crate::decision::Decision;
use crate::decoded::DecodedPhoto;

/// A rule that keeps or rejects photos by thresholds on a measure of each photo.
pub trait Filter: Send + Sync + Sized + 'static {
    /// Name in pipeline.toml and in keys; also the verdict of the photos it rejects.
    const NAME: &'static str;
    /// One line of help.
    const ABOUT: &'static str;
    /// Version of the measure, raised by hand when [`Filter::MEASURE`] may return something else for a photo; the kept
    /// measures of all filters are then computed again. 0 where there is no measure.
    const MEASURE_VERSION: u32;
    /// Version of the decision, raised by hand when `decide` may answer differently; the kept measures stay.
    const DECISION_VERSION: u32;
    /// Version of the stage, part of the key of its nodes: raising either of the two above gives it a new value.
    const VERSION: u32 = Self::MEASURE_VERSION + Self::DECISION_VERSION;
    /// Thresholds and choice of rule; the doc comments of its fields are the help text.
    type Params: DeserializeOwned + JsonSchema + ContentHash + Send + Sync + 'static;
    /// What is measured of a photo, kept as JSON.
    type Measure: Serialize + DeserializeOwned;

    /// Checks the thresholds.
    ///
    /// # Errors
    /// Names the key that is out of range.
    fn check(params: &Self::Params) -> Result<(), ParamError>;

    /// Returns the photos on which a person has decided.
    fn by_hand(params: &Self::Params) -> &ByHand;

    /// Measures one photo, as a pure function of its pixels; facts may change while the bytes stay, so they are read
    /// in `decide`. `None` where the facts are enough; `Measure` is then `()`.
    ///
    /// All filters measure a photo together, from one decode (`survey.rs`).
    const MEASURE: Option<fn(&DecodedPhoto) -> Self::Measure>;

    /// Digests of the filter's answers on fixed photos, beside the versions they belong to.
    #[cfg(test)]
    const GUARD: crate::guard::Guard;

    /// Returns one decision for each photo, in the same order; no decision depends on the order.
    fn decide(params: &Self::Params, photos: &[MeasuredPhoto<Self::Measure>]) -> Vec<Decision>;
}

/// A photo with its measure and the facts of its archive.
pub struct MeasuredPhoto<M> {
    /// Name of the photo.
    pub id: String,
    /// Facts from its archive.
    pub facts: PhotoFacts,
    /// What [`Filter::MEASURE`] returned.
    pub measure: M,
}

/// Reads the facts of a row.
///
/// # Errors
/// Facts that are not those of a photo, with the photo's id.
pub(crate) fn facts_of(row: &Row) -> Result<PhotoFacts, StageError> {
    PhotoFacts::from_json(&row.facts).map_err(|error| {
        StageError::new(format!("facts of photo `{}` cannot be read", row.id)).cause(error.to_string())
    })
}

/// Returns the verdict of a photo that could not be decoded.
pub(crate) fn undecodable(row: &Row, facts: &PhotoFacts, reason: String) -> Verdict {
    let decision = Decision {
        keep: false,
        ..Decision::pass(reason)
    };
    decision.verdict(crate::DECODE, row, facts)
}

/// Checks that the value of `key` is in `[low, high]`.
///
/// # Errors
/// A value outside, and NaN.
pub(crate) fn check_range(key: &str, value: f64, low: f64, high: f64) -> Result<(), ParamError> {
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err(ParamError::new(key, format!("{value} is not in [{low}, {high}]")))
    }
}

use marf_cache::{ContentHash, manifest::Row};
use marf_scene::PhotoFacts;
use marf_stage::{ParamError, StageError, Verdict};
use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};

use crate::by_hand::ByHand;
use crate::decoded::DecodedPhoto;

/// A rule that keeps or rejects photos, its measure apart from its decision.
pub trait Filter: Send + Sync + Sized + 'static {
    /// Name in pipeline.toml, in keys, and the verdict of what it rejects.
    const NAME: &'static str;
    /// One line for people.
    const ABOUT: &'static str;
    /// Raised by hand when `measure` or `decide` may answer differently.
    const VERSION: u32;
    /// Thresholds and rules; doc comments of its fields become the help text.
    type Params: DeserializeOwned + JsonSchema + ContentHash + Send + Sync + 'static;
    /// What is kept per photo.
    type Measure: Serialize + DeserializeOwned;

    /// Checks the thresholds.
    ///
    /// # Errors
    /// Names the key that is out of range.
    fn check(params: &Self::Params) -> Result<(), ParamError>;

    /// Returns what a person has decided on single photos.
    fn by_hand(params: &Self::Params) -> &ByHand;

    /// Measures one photo, a pure function of its pixels: facts may change while the bytes stay, so they are read in
    /// `decide`. `None` where facts are enough; `Measure` is then `()`.
    ///
    /// All filters of the table measure a photo in one go, from one decode (`survey.rs`).
    const MEASURE: Option<fn(&DecodedPhoto) -> Self::Measure>;

    /// Returns one decision for each photo, in the same order; the decisions themselves do not depend on it.
    fn decide(params: &Self::Params, photos: &[MeasuredPhoto<Self::Measure>]) -> Vec<Decision>;
}

/// A photo at the moment of decision.
pub struct MeasuredPhoto<M> {
    /// Name of the photo.
    pub id: String,
    /// What its archive says of it.
    pub facts: PhotoFacts,
    /// What was measured.
    pub measure: M,
}

/// What a filter says of one photo.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// Whether the photo stays.
    pub keep: bool,
    /// The number the decision rests on, in the filter's own unit.
    pub score: Option<f64>,
    /// What it was held against.
    pub threshold: Option<f64>,
    /// The photo that stays in its place.
    pub twin: Option<String>,
    /// One sentence; empty where a kept photo needs no word.
    pub reason: String,
}

impl Decision {
    /// The photo stays: `score` is on the good side of `threshold`.
    pub fn keep(score: f64, threshold: f64) -> Self {
        Self {
            keep: true,
            ..Self::reject(score, threshold, String::new())
        }
    }

    /// The photo stays without being held against anything, and why.
    pub fn pass(reason: impl Into<String>) -> Self {
        Self {
            keep: true,
            score: None,
            threshold: None,
            twin: None,
            reason: reason.into(),
        }
    }

    /// The photo goes.
    pub fn reject(score: f64, threshold: f64, reason: impl Into<String>) -> Self {
        Self {
            keep: false,
            score: Some(score),
            threshold: Some(threshold),
            twin: None,
            reason: reason.into(),
        }
    }

    /// Returns the verdict of filter `name` on the photo of `row`.
    pub(crate) fn verdict(self, name: &str, row: &Row, facts: &PhotoFacts) -> Verdict {
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

/// Returns the facts of a row.
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

fn file_of(row: &Row, facts: &PhotoFacts) -> String {
    if facts.file.is_empty() {
        &row.id
    } else {
        &facts.file
    }
    .clone()
}

/// Refuses a number outside `[low, high]`, and NaN.
pub(crate) fn check_range(key: &str, value: f64, low: f64, high: f64) -> Result<(), ParamError> {
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err(ParamError::new(key, format!("{value} is not in [{low}, {high}]")))
    }
}

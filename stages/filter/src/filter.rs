//! What a filter is: a measure of one photo, and a decision by thresholds.

use marf_cache::manifest::Row;
use marf_stage::{ParamError, StageError, Verdict};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize, de::DeserializeOwned, de::IgnoredAny};

use crate::by_hand::ByHand;
use crate::comparison::AnyPass;
use crate::decision::Decision;
use crate::decoded::DecodedPhoto;

/// A rule that keeps or rejects photos by thresholds on a measure of each photo.
pub trait Filter: Send + Sync + Sized + 'static {
    /// Name in pipeline.toml and in keys, and of the table of its measures; also the verdict of the photos it rejects.
    const NAME: &'static str;
    /// One line of help.
    const ABOUT: &'static str;
    /// What to write in its table so that photos which it rejects are kept, for people.
    const RELAX: &'static str;
    /// Version of the measure, raised by hand when [`Filter::MEASURE`] may return something else for a photo; this
    /// measure of all photos is then computed again. 0 where there is no measure.
    const MEASURE_VERSION: u32;
    /// Version of the decision, raised by hand when `decide` may answer differently; the kept measures stay.
    const DECISION_VERSION: u32;
    /// Version of the stage, part of the key of its nodes: raising either of the two above gives it a new value.
    const VERSION: u32 = Self::MEASURE_VERSION + Self::DECISION_VERSION;
    /// Thresholds and choice of rule; the doc comments of its fields are the help text.
    type Params: Serialize + DeserializeOwned + JsonSchema + Send + Sync + 'static;
    /// What is measured of a photo.
    type Measure<'a>: Stored<'a>;
    /// What decisions compare the photos of an instrument with; `()` where they look at the photo alone.
    type Context: for<'a> Stored<'a>;

    /// Checks the thresholds.
    ///
    /// # Errors
    /// Names the key that is out of range.
    fn check(params: &Self::Params) -> Result<(), ParamError>;

    /// Returns the photos on which a person has decided.
    fn by_hand(params: &Self::Params) -> &ByHand;

    /// Returns the passes over all photos that find [`Filter::Context`], in order; none where a decision looks at its photo
    /// alone.
    fn passes(_params: &Self::Params) -> &'static [&'static dyn AnyPass<Self>] {
        &[]
    }

    /// Measures one photo, as a pure function of its pixels; facts may change while the bytes stay, so they are read
    /// in `decide`. `None` where the facts are enough; `Measure` is then `()`.
    ///
    /// One decode serves all filters that lack a measure of a photo (`survey.rs`).
    const MEASURE: Option<fn(&DecodedPhoto<'_>) -> Self::Measure<'static>>;

    /// Digests of the filter's answers on fixed photos, beside the versions they belong to.
    #[cfg(test)]
    const GUARD: crate::guard::Guard;

    /// Returns the decision on a photo. `context` is what its instrument is compared with; `None` where it is not.
    fn decide<'a>(
        params: &Self::Params,
        context: Option<&Self::Context>,
        photo: &MeasuredPhoto<'a, Self::Measure<'a>>,
    ) -> Decision;
}

/// A value that is kept as bytes; it may borrow them.
pub trait Stored<'a>: Sized {
    /// Returns the value as bytes, the same on every machine.
    fn encode(&self) -> Vec<u8>;

    /// Reads what [`Stored::encode`] returned; `None` if the bytes are not that.
    fn decode(bytes: &'a [u8]) -> Option<Self>;
}

/// Nothing: no bytes.
impl Stored<'_> for () {
    fn encode(&self) -> Vec<u8> {
        Vec::new()
    }

    fn decode(bytes: &[u8]) -> Option<Self> {
        bytes.is_empty().then_some(())
    }
}

/// A photo with its measure and the facts of its archive.
pub struct MeasuredPhoto<'a, M> {
    /// Name of the photo.
    pub id: &'a str,
    /// Facts from its archive.
    pub facts: Facts<'a>,
    /// What [`Filter::MEASURE`] returned.
    pub measure: M,
}

/// What filters read of the facts of a photo ([`marf_scene::PhotoFacts`]), borrowed from its row: no text is copied for a
/// decision.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Facts<'a> {
    /// Name of the file in its archive.
    pub file: &'a str,
    /// Bytes of the image as stored in the archive.
    pub size_bytes: u64,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Bands stored in the file, 1 or 3.
    pub bands: u8,
    /// Sol.
    pub sol: Option<u32>,
    /// Instrument and eye as the archive names them.
    pub instrument: Option<&'a str>,
    /// Colour filter as the archive names it.
    pub filter: Option<&'a str>,
    /// Whether the archive calls it a thumbnail.
    pub thumbnail: bool,
    /// Camera model and pose, which [`marf_scene::PhotoFacts`] holds.
    #[serde(rename = "prior")]
    _prior: IgnoredAny,
    #[serde(rename = "focal_px")]
    _focal_px: IgnoredAny,
    #[serde(rename = "device")]
    _device: IgnoredAny,
    #[serde(rename = "notes")]
    _notes: IgnoredAny,
}

impl<'a> Facts<'a> {
    /// Reads the facts of a row.
    ///
    /// # Errors
    /// Facts that are not those of a photo, with the photo's id.
    pub(crate) fn of(row: &'a Row) -> Result<Self, StageError> {
        Self::deserialize(&row.facts).map_err(|error| unreadable_facts(row, &error))
    }
}

/// Returns the error of facts that are not those of a photo.
pub(crate) fn unreadable_facts(row: &Row, cause: &serde_json::Error) -> StageError {
    StageError::new(format!("facts of photo `{}` cannot be read", row.id)).cause(cause.to_string())
}

/// Returns the verdict of a photo that could not be decoded.
pub(crate) fn undecodable(row: &Row, facts: &Facts<'_>, reason: String) -> Verdict {
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

#[cfg(test)]
mod tests {
    use marf_scene::PhotoFacts;
    use serde_json::json;

    use super::*;

    fn row(facts: serde_json::Value) -> Row {
        Row {
            id: "a".to_owned(),
            blobs: Default::default(),
            facts,
        }
    }

    #[test]
    fn facts_are_those_of_the_row_and_what_is_no_fact_is_refused() {
        let whole = PhotoFacts {
            file: "dir/a.jpg".to_owned(),
            size_bytes: 7,
            width: 40,
            height: 30,
            bands: 3,
            sol: Some(9),
            instrument: Some("ZL".to_owned()),
            filter: Some("0".to_owned()),
            thumbnail: true,
            focal_px: Some(3.0),
            device: Some("phone".to_owned()),
            notes: vec!["turned".to_owned()],
            prior: None,
        };
        let row_of_whole = row(whole.to_json());
        let facts = Facts::of(&row_of_whole).unwrap();
        assert_eq!(
            (facts.file, facts.size_bytes, facts.sol),
            ("dir/a.jpg", 7, Some(9))
        );
        assert_eq!((facts.width, facts.height, facts.bands), (40, 30, 3));
        assert_eq!(
            (facts.instrument, facts.filter, facts.thumbnail),
            (Some("ZL"), Some("0"), true)
        );
        for odd in [json!({"widht": 3}), json!({"width": -3}), json!(7)] {
            let error = Facts::of(&row(odd)).unwrap_err().to_string();
            assert_eq!(error, "facts of photo `a` cannot be read");
        }
    }
}

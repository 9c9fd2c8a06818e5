//! What a filter is: a measure of one photo, and a decision by thresholds, which may compare photos with each other.
//! Invariant: photos of different instruments are not compared.

use std::collections::BTreeMap;
use std::sync::Arc;

use marf_stage::{ParamError, StageError};
use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};

use crate::by_hand::ByHand;
use crate::bytes::{from_bytes, to_bytes};
use crate::decision::Decision;
use crate::decoded::DecodedPhoto;
use crate::facts::Facts;
#[cfg(test)]
use crate::section::Guard;
use crate::section::damaged;

/// A rule that keeps or rejects photos by thresholds on a measure of each photo.
pub trait Filter: Send + Sync + Sized + 'static {
    /// Name in pipeline.toml and in keys, of the table of its measures, and the verdict of the photos it rejects.
    const NAME: &'static str;
    /// One line of help.
    const ABOUT: &'static str;
    /// What to write in its table so that photos which it rejects are kept, for people.
    const RELAX: &'static str;
    /// Version of the measure, raised by hand when [`Filter::MEASURE`] may return another value for a photo. This
    /// measure of all photos is then computed again. 0 without a measure.
    const MEASURE_VERSION: u32;
    /// Version of the decision, raised by hand when `decide` may answer differently. The kept measures stay.
    const DECISION_VERSION: u32;
    /// Version of the stage, part of the key of its nodes: raising either of the two above gives it a new value.
    const VERSION: u32 = Self::MEASURE_VERSION + Self::DECISION_VERSION;
    /// Thresholds and choice of rule. The doc comments of its fields are the help text.
    type Params: Serialize + DeserializeOwned + JsonSchema + Send + Sync + 'static;
    /// What is measured of a photo.
    type Measure: Serialize + DeserializeOwned;
    /// The statistics that decisions compare the photos of an instrument with. `()` if a decision needs its photo
    /// alone.
    type Context: Serialize + DeserializeOwned;

    /// Checks the thresholds.
    ///
    /// # Errors
    /// Names the key that is out of range.
    fn check(params: &Self::Params) -> Result<(), ParamError>;

    /// Returns the photos on which a person has decided.
    fn by_hand(params: &Self::Params) -> &ByHand;

    /// Returns the passes over all photos that find [`Filter::Context`], in order. Empty if a decision needs its
    /// photo alone.
    fn passes(_params: &Self::Params) -> &'static [&'static dyn AnyPass<Self>] {
        &[]
    }

    /// Measures one photo, as a pure function of its pixels. Facts may change while the bytes stay, so they are read
    /// in `decide`. `None` if the facts are enough, with `()` as `Measure`.
    ///
    /// One decode serves all filters that lack a measure of a photo (`survey.rs`).
    const MEASURE: Option<fn(&DecodedPhoto<'_>) -> Self::Measure>;

    /// Digests of the filter's answers on fixed photos, with the versions they belong to.
    #[cfg(test)]
    const GUARD: Guard;

    /// Returns the decision on a photo. `context` holds the statistics of its instrument, `None` without a
    /// comparison.
    fn decide(
        params: &Self::Params,
        context: Option<&Self::Context>,
        photo: &MeasuredPhoto<'_, Self::Measure>,
    ) -> Decision;
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

/// A pass over all photos of an instrument, which finds what decisions compare a photo with, or a part of that.
///
/// Summaries are per sol, and no parameter changes one. Their total must not depend on how photos are spread over
/// sols.
pub trait Pass<F: Filter>: Sync {
    /// Name of the pass, in the keys of its summaries.
    const NAME: &'static str;
    /// What is known of some photos, or of all.
    type Total: Default + Serialize + DeserializeOwned;

    /// Returns the summary of some photos, the same for any order of the photos. `before` is the result of the previous pass,
    /// `None` in the first.
    fn summarise(before: Option<&F::Context>, photos: &[&MeasuredPhoto<'_, F::Measure>]) -> Self::Total;

    /// Adds a summary to others, in any order. `None` if they are more than can be counted.
    fn add(total: &mut Self::Total, summary: Self::Total) -> Option<()>;

    /// Returns the result of the pass. `None` if the photos are too few to be compared with each other.
    ///
    /// It holds only the inputs of later passes and decisions: if it comes out equal, no photo is decided again.
    fn conclude(params: &F::Params, before: Option<F::Context>, total: Self::Total) -> Option<F::Context>;
}

/// A [`Pass`] of any type, on the photos of all instruments and on bytes.
pub trait AnyPass<F: Filter>: Sync {
    /// Returns [`Pass::NAME`].
    fn name(&self) -> &'static str;

    /// Returns the summaries of some photos by instrument. `before` is `None` in the first pass. In a later one, an
    /// instrument that it lacks is left out.
    ///
    /// # Errors
    /// A summary that cannot be written.
    fn summarise(
        &self,
        before: Option<&Contexts<F>>,
        photos: &[MeasuredPhoto<'_, F::Measure>],
    ) -> Result<Vec<u8>, StageError>;

    /// Returns the result of the pass for each instrument.
    ///
    /// # Errors
    /// The first error of `summaries`, and bytes that are not a summary.
    fn conclude(
        &self,
        params: &F::Params,
        before: Option<Contexts<F>>,
        summaries: &mut dyn Iterator<Item = Result<Arc<[u8]>, StageError>>,
    ) -> Result<Contexts<F>, StageError>;
}

impl<F: Filter, P: Pass<F>> AnyPass<F> for P {
    fn name(&self) -> &'static str {
        P::NAME
    }

    fn summarise(
        &self,
        before: Option<&Contexts<F>>,
        photos: &[MeasuredPhoto<'_, F::Measure>],
    ) -> Result<Vec<u8>, StageError> {
        let mut groups = BTreeMap::<_, Vec<_>>::new();
        for photo in photos {
            groups.entry(photo.facts.instrument).or_default().push(photo);
        }
        let mut summaries = BTreeMap::new();
        for (instrument, photos) in groups {
            let own = before.and_then(|before| before.get(instrument));
            if before.is_none() || own.is_some() {
                summaries.insert(instrument, P::summarise(own, &photos));
            }
        }
        to_bytes(&summaries)
    }

    fn conclude(
        &self,
        params: &F::Params,
        before: Option<Contexts<F>>,
        summaries: &mut dyn Iterator<Item = Result<Arc<[u8]>, StageError>>,
    ) -> Result<Contexts<F>, StageError> {
        let mut totals = BTreeMap::<Option<String>, P::Total>::new();
        for summary in summaries {
            let parts: Option<BTreeMap<Option<String>, P::Total>> = from_bytes(&summary?);
            for (instrument, part) in parts.ok_or_else(|| unreadable::<F>("summary"))? {
                P::add(totals.entry(instrument).or_default(), part)
                    .ok_or_else(|| unreadable::<F>("summary"))?;
            }
        }
        let mut before = before.map_or_else(BTreeMap::new, |before| before.0);
        let concluded = totals.into_iter().filter_map(|(instrument, total)| {
            let own = before.remove(&instrument);
            Some((instrument, P::conclude(params, own, total)?))
        });
        Ok(Contexts(concluded.collect()))
    }
}

/// Statistics of each instrument whose photos are compared with each other.
pub struct Contexts<F: Filter>(BTreeMap<Option<String>, F::Context>);

impl<F: Filter> Contexts<F> {
    /// Returns the statistics of an instrument.
    pub(crate) fn get(&self, instrument: Option<&str>) -> Option<&F::Context> {
        self.0.get(&instrument.map(str::to_owned))
    }

    /// Returns the bytes, equal for equal contexts. Empty without instruments.
    ///
    /// # Errors
    /// A context that cannot be written.
    pub(crate) fn encode(&self) -> Result<Vec<u8>, StageError> {
        if self.0.is_empty() {
            return Ok(Vec::new());
        }
        to_bytes(&self.0)
    }

    /// Reads what [`Contexts::encode`] returned.
    ///
    /// # Errors
    /// Other bytes.
    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, StageError> {
        if bytes.is_empty() {
            return Ok(Self(BTreeMap::new()));
        }
        let contexts = from_bytes(bytes).ok_or_else(|| unreadable::<F>("context"))?;
        Ok(Self(contexts))
    }
}

fn unreadable<F: Filter>(what: &str) -> StageError {
    damaged(format!("a {what} of filter `{}` cannot be read", F::NAME))
}

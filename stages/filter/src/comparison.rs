//! How photos are compared with each other: passes over all photos, in which each sol is summarised. Invariant: photos of
//! different instruments are not compared.

use std::collections::BTreeMap;
use std::sync::Arc;

use marf_stage::StageError;

use crate::bytes::{put_part, put_text, take_part, take_text};
use crate::filter::{Filter, MeasuredPhoto, Stored};
use crate::survey::damaged;

/// A pass over all photos of an instrument, which finds what decisions compare a photo with, or a part of that.
///
/// Summaries are of sols, and no parameter changes one; what comes of them must not depend on how photos are spread over sols.
pub trait Pass<F: Filter>: Sync {
    /// Name of the pass, in the keys of its summaries.
    const NAME: &'static str;
    /// All summaries together.
    type Total: Default;

    /// Returns the summary of some photos: bytes, the same for any order of the photos. `before` is what the pass before has
    /// found; `None` in the first.
    fn summarise<'a>(before: Option<&F::Context>, photos: &[&MeasuredPhoto<'a, F::Measure<'a>>]) -> Vec<u8>;

    /// Adds a summary to others, in any order; `None` if the bytes are not what `summarise` returned.
    fn add(total: &mut Self::Total, summary: &[u8]) -> Option<()>;

    /// Returns what the pass has found; `None` where photos are not compared with each other, because they are too few.
    ///
    /// It holds only what a later pass or a decision can depend on: where it comes out equal, no photo is decided again.
    fn conclude(params: &F::Params, before: Option<F::Context>, total: Self::Total) -> Option<F::Context>;
}

/// A [`Pass`] of any type, on the photos of all instruments and on bytes.
pub trait AnyPass<F: Filter>: Sync {
    /// Returns [`Pass::NAME`].
    fn name(&self) -> &'static str;

    /// Returns the summaries of some photos by instrument. `before` is `None` in the first pass; an instrument that is not in
    /// it is left out in a later one.
    fn summarise<'a>(
        &self,
        before: Option<&Contexts<F>>,
        photos: &[MeasuredPhoto<'a, F::Measure<'a>>],
    ) -> Vec<u8>;

    /// Returns what the pass has found of each instrument.
    ///
    /// # Errors
    /// The first error of `summaries`, and bytes that are no summary.
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

    fn summarise<'a>(
        &self,
        before: Option<&Contexts<F>>,
        photos: &[MeasuredPhoto<'a, F::Measure<'a>>],
    ) -> Vec<u8> {
        let mut groups = BTreeMap::<_, Vec<_>>::new();
        for photo in photos {
            groups.entry(photo.facts.instrument).or_default().push(photo);
        }
        let mut bytes = Vec::new();
        for (instrument, photos) in groups {
            let own = before.and_then(|before| before.of(instrument));
            if before.is_none() || own.is_some() {
                put_text(&mut bytes, instrument);
                put_part(&mut bytes, &P::summarise(own, &photos));
            }
        }
        bytes
    }

    fn conclude(
        &self,
        params: &F::Params,
        before: Option<Contexts<F>>,
        summaries: &mut dyn Iterator<Item = Result<Arc<[u8]>, StageError>>,
    ) -> Result<Contexts<F>, StageError> {
        let mut totals = BTreeMap::<Option<String>, P::Total>::new();
        for summary in summaries {
            let added = each_part(&summary?, |instrument, part| {
                P::add(totals.entry(instrument).or_default(), part)
            });
            added.ok_or_else(|| unreadable::<F>("summary"))?;
        }
        let mut before = before.map_or_else(BTreeMap::new, |before| before.0);
        let concluded = totals.into_iter().filter_map(|(instrument, total)| {
            let own = before.remove(&instrument);
            Some((instrument, P::conclude(params, own, total)?))
        });
        Ok(Contexts(concluded.collect()))
    }
}

/// What the photos of each instrument are compared with; none of an instrument whose photos are not.
pub struct Contexts<F: Filter>(BTreeMap<Option<String>, F::Context>);

impl<F: Filter> Contexts<F> {
    /// Returns what the photos of an instrument are compared with.
    pub(crate) fn of(&self, instrument: Option<&str>) -> Option<&F::Context> {
        self.0.get(&instrument.map(str::to_owned))
    }

    /// Returns the bytes, equal for equal contexts; none of no instrument.
    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for (instrument, context) in &self.0 {
            put_text(&mut bytes, instrument.as_deref());
            put_part(&mut bytes, &context.encode());
        }
        bytes
    }

    /// Reads what [`Contexts::encode`] returned.
    ///
    /// # Errors
    /// Other bytes.
    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, StageError> {
        let mut contexts = BTreeMap::new();
        let read = each_part(bytes, |instrument, part| {
            contexts.insert(instrument, F::Context::decode(part)?);
            Some(())
        });
        read.ok_or_else(|| unreadable::<F>("context"))?;
        Ok(Self(contexts))
    }
}

/// Calls a function with each instrument and the bytes behind it; `None` if they are cut short or the function says so.
fn each_part(mut bytes: &[u8], mut found: impl FnMut(Option<String>, &[u8]) -> Option<()>) -> Option<()> {
    while !bytes.is_empty() {
        let instrument = take_text(&mut bytes)?;
        found(instrument.map(str::to_owned), take_part(&mut bytes)?)?;
    }
    Some(())
}

fn unreadable<F: Filter>(what: &str) -> StageError {
    damaged(format!("a {what} of filter `{}` cannot be read", F::NAME))
}

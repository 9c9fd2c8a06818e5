//! A filter as a stage of a pipeline.

use std::sync::Arc;

use marf_stage::{
    Comparison, Define, Map, Measured, PHOTOS, ParamError, Port, Stage, StageError, Table, VERDICTS, Verdict,
    Work,
};

use crate::bytes::{from_bytes, to_bytes};
use crate::decision::undecodable;
use crate::facts::Facts;
use crate::filter::{Contexts, Filter, MeasuredPhoto};
#[cfg(test)]
use crate::section::Guard;
use crate::section::{Section, Surveyed, measured, unreadable};

/// Inputs of every filter: one set of photos.
pub(crate) const PORTS: &[Port] = &[Port::required("input", PHOTOS)];
/// Outputs of every filter: the photos that are kept, and a verdict on each photo.
pub(crate) const OUTPUTS: &[&str] = &[PHOTOS, VERDICTS];

/// The stage that runs a [`Filter`] with its parameters.
pub struct FilterStage<F: Filter> {
    params: F::Params,
}

impl<F: Filter> Define for FilterStage<F> {
    type Params = F::Params;
    const NAME: &'static str = F::NAME;
    const ABOUT: &'static str = F::ABOUT;
    const VERSION: u32 = F::VERSION;
    const RELAX: Option<&'static str> = Some(F::RELAX);
    const PORTS: &'static [Port] = PORTS;
    const OUTPUTS: &'static [&'static str] = OUTPUTS;

    fn new(params: F::Params) -> Result<Self, ParamError> {
        F::by_hand(&params).check()?;
        F::check(&params)?;
        Ok(Self { params })
    }
}

impl<F: Filter> Stage for FilterStage<F> {
    fn params(&self) -> serde_json::Value {
        marf_stage::key_params(&self.params, &[])
    }

    fn work(&self) -> Work<'_> {
        Work::Map(self)
    }
}

impl<F: Filter> Surveyed for FilterStage<F> {
    const SECTION: Option<Section> = match F::MEASURE {
        None => None,
        Some(_) => Some(Section {
            table: Table {
                name: F::NAME,
                version: F::MEASURE_VERSION,
            },
            measure: |_, photo| {
                F::MEASURE.map_or_else(|| Ok(Vec::new()), |measure| to_bytes(&measure(photo)))
            },
        }),
    };
    #[cfg(test)]
    const GUARD: Guard = F::GUARD;
}

impl<F: Filter> Map for FilterStage<F> {
    fn comparison(&self) -> Option<&dyn Comparison> {
        let compares = !F::passes(&self.params).is_empty();
        compares.then_some(self as &dyn Comparison)
    }

    fn decide(&self, context: &[u8], items: &[Measured<'_>]) -> Result<Vec<Verdict>, StageError> {
        let contexts = Contexts::<F>::decode(context)?;
        let by_hand = F::by_hand(&self.params);
        let decide = |item: &Measured<'_>| match read::<F>(item)? {
            Err(refused) => Ok(refused),
            Ok(photo) => {
                let context = contexts.get(photo.facts.instrument);
                let decision = F::decide(&self.params, context, &photo);
                let decision = by_hand.overrule(photo.id, photo.facts.file, decision);
                Ok(decision.verdict(F::NAME, item.row, &photo.facts))
            }
        };
        items.iter().map(decide).collect()
    }
}

impl<F: Filter> Comparison for FilterStage<F> {
    fn passes(&self) -> Vec<&'static str> {
        F::passes(&self.params).iter().map(|pass| pass.name()).collect()
    }

    fn summarise(&self, pass: usize, context: &[u8], items: &[Measured<'_>]) -> Result<Vec<u8>, StageError> {
        let before = before::<F>(pass, context)?;
        let mut photos = Vec::with_capacity(items.len());
        for item in items {
            photos.extend(read::<F>(item)?.ok());
        }
        F::passes(&self.params)[pass].summarise(before.as_ref(), &photos)
    }

    fn context(
        &self,
        pass: usize,
        context: &[u8],
        summaries: &mut dyn Iterator<Item = Result<Arc<[u8]>, StageError>>,
    ) -> Result<Vec<u8>, StageError> {
        let before = before::<F>(pass, context)?;
        let found = F::passes(&self.params)[pass].conclude(&self.params, before, summaries)?;
        found.encode()
    }
}

/// Reads the contexts before a pass. `None` before the first.
fn before<F: Filter>(pass: usize, context: &[u8]) -> Result<Option<Contexts<F>>, StageError> {
    (pass > 0).then(|| Contexts::decode(context)).transpose()
}

/// Reads a photo with its facts and its measure. The inner error is the verdict on one that could not be decoded.
fn read<'a, F: Filter>(
    item: &Measured<'a>,
) -> Result<Result<MeasuredPhoto<'a, F::Measure>, Verdict>, StageError> {
    let facts = Facts::from_row(item.row)?;
    Ok(match read_measure::<F>(item)? {
        Ok(measure) => Ok(MeasuredPhoto {
            id: item.row.id.as_str(),
            facts,
            measure,
        }),
        Err(reason) => Err(undecodable(item.row, &facts, reason)),
    })
}

/// Reads the measure of one filter. The inner error says why the photo could not be decoded.
fn read_measure<F: Filter>(item: &Measured<'_>) -> Result<Result<F::Measure, String>, StageError> {
    let part = match F::MEASURE {
        None => Ok(item.measure),
        Some(_) => measured(item.measure, item.row)?,
    };
    let decode = |part| {
        from_bytes(part).ok_or_else(|| unreadable(item.row, format!("it is not of filter `{}`", F::NAME)))
    };
    part.map_or_else(|reason| Ok(Err(reason)), |part| decode(part).map(Ok))
}

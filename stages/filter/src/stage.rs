//! A filter as a stage of a pipeline.

use marf_cache::{ContentHash, manifest::Row};
use marf_stage::{
    Ctx, Define, Map, Measure, Measured, PHOTOS, ParamError, Port, Stage, StageError, VERDICTS, Verdict, Work,
};

use crate::filter::{Filter, MeasuredPhoto, facts_of, undecodable};
use crate::survey::{self, Section, Surveyed, survey, unreadable};
use crate::{SECTION_VERSIONS, SECTIONS};

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
            name: F::NAME,
            version: F::MEASURE_VERSION,
            measure: |photo| match F::MEASURE {
                Some(measure) => serde_json::to_vec(&measure(photo)),
                None => Ok(Vec::new()),
            },
        }),
    };
    #[cfg(test)]
    const GUARD: crate::guard::Guard = F::GUARD;
}

impl<F: Filter> Measure for FilterStage<F> {
    /// Returns the versions of the measures; no parameter of a filter changes a measure.
    fn measure_params(&self) -> &dyn ContentHash {
        if F::MEASURE.is_some() {
            &SECTION_VERSIONS
        } else {
            &NO_PARAMS
        }
    }

    fn shared(&self) -> Option<(&'static str, u32)> {
        F::MEASURE.map(|_| survey::TABLE)
    }

    /// Returns the survey of the photo; no bytes where the facts are enough.
    fn measure(&self, ctx: &Ctx<'_>, row: &Row) -> Result<Vec<u8>, StageError> {
        match F::MEASURE {
            Some(_) => survey(SECTIONS, ctx, row),
            None => Ok(Vec::new()),
        }
    }
}

impl<F: Filter> Map for FilterStage<F> {
    fn decide(&self, items: &[Measured<'_>]) -> Result<Vec<Verdict>, StageError> {
        let mut measured = Vec::with_capacity(items.len());
        let mut undecodables = Vec::with_capacity(items.len());
        for item in items {
            let facts = facts_of(item.row)?;
            match read_measure::<F>(item)? {
                Ok(measure) => {
                    undecodables.push(None);
                    measured.push(MeasuredPhoto {
                        id: item.row.id.clone(),
                        facts,
                        measure,
                    });
                }
                Err(reason) => undecodables.push(Some(undecodable(item.row, &facts, reason))),
            }
        }
        let decisions = F::decide(&self.params, &measured);
        let by_hand = F::by_hand(&self.params);
        let mut decided = measured.iter().zip(decisions);
        let verdicts = items.iter().zip(undecodables).map(|(item, undecodable)| {
            let missing = || StageError::new(format!("filter `{}` gave too few decisions", F::NAME));
            undecodable.map_or_else(
                || {
                    let (photo, decision) = decided.next().ok_or_else(missing)?;
                    let decision = by_hand.overrule(&photo.id, &photo.facts.file, decision);
                    Ok(decision.verdict(F::NAME, item.row, &photo.facts))
                },
                Ok,
            )
        });
        verdicts.collect()
    }
}

/// Parameters of the measure of a filter that needs the facts alone: none.
const NO_PARAMS: [u8; 0] = [];

/// Reads the measure of one filter from a survey; the inner error says why the photo could not be decoded.
fn read_measure<F: Filter>(item: &Measured<'_>) -> Result<Result<F::Measure, String>, StageError> {
    let part = match F::MEASURE {
        // Without a measure the bytes are empty, and the unit type is JSON's `null`.
        None if item.measure.is_empty() => Ok(&b"null"[..]),
        None => return Err(unreadable(item.row, "it should be empty")),
        Some(_) => survey::part(item.measure, F::NAME, item.row)?,
    };
    let parse = |part| serde_json::from_slice(part).map_err(|error| unreadable(item.row, error));
    part.map(parse)
        .map_or_else(|reason| Ok(Err(reason)), |measure| measure.map(Ok))
}

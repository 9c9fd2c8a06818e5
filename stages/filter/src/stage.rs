use marf_cache::{ContentHash, manifest::Row};
use marf_stage::{
    Ctx, Define, Map, Measure, Measured, PHOTOS, ParamError, Port, Stage, StageError, VERDICTS, Verdict, Work,
};

use crate::filter::{Filter, MeasuredPhoto, facts_of, undecodable};
use crate::survey::{self, Section, Surveyed, survey, unreadable};
use crate::{SECTIONS, VERSIONS};

/// Inputs of every filter: one set of photos.
pub(crate) const PORTS: &[Port] = &[Port::required("input", PHOTOS)];
/// Outputs of every filter: the photos that stay, and what became of each.
pub(crate) const OUTPUTS: &[&str] = &[PHOTOS, VERDICTS];

/// A [`Filter`] with its parameters, as a stage.
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
    fn params(&self) -> &dyn ContentHash {
        &self.params
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
            version: F::VERSION,
            measure: |look| match F::MEASURE {
                Some(measure) => serde_json::to_vec(&measure(look)),
                None => Ok(Vec::new()),
            },
        }),
    };
}

impl<F: Filter> Measure for FilterStage<F> {
    /// No parameter of a filter changes what it measures.
    fn measure_params(&self) -> &dyn ContentHash {
        if F::MEASURE.is_some() {
            &VERSIONS
        } else {
            &NO_PARAMS
        }
    }

    fn shared(&self) -> Option<(&'static str, u32)> {
        F::MEASURE.map(|_| survey::TABLE)
    }

    /// Returns the survey of the photo; nothing where facts are enough.
    fn measure(&self, ctx: &Ctx<'_>, row: &Row) -> Result<Vec<u8>, StageError> {
        match F::MEASURE {
            Some(_) => survey(SECTIONS, ctx, row),
            None => Ok(Vec::new()),
        }
    }
}

impl<F: Filter> Map for FilterStage<F> {
    fn decide(&self, items: &[Measured<'_>]) -> Result<Vec<Verdict>, StageError> {
        let mut seen = Vec::with_capacity(items.len());
        let mut unread = Vec::with_capacity(items.len());
        for item in items {
            let facts = facts_of(item.row)?;
            match read::<F>(item)? {
                Ok(measure) => {
                    unread.push(None);
                    seen.push(MeasuredPhoto {
                        id: item.row.id.clone(),
                        facts,
                        measure,
                    });
                }
                Err(reason) => unread.push(Some(undecodable(item.row, &facts, reason))),
            }
        }
        let decisions = F::decide(&self.params, &seen);
        let by_hand = F::by_hand(&self.params);
        let mut judged = seen.iter().zip(decisions);
        let verdicts = items.iter().zip(unread).map(|(item, unread)| {
            let missing = || StageError::new(format!("filter `{}` gave too few decisions", F::NAME));
            unread.map_or_else(
                || {
                    let (seen, decision) = judged.next().ok_or_else(missing)?;
                    let decision = by_hand.overrule(&seen.id, &seen.facts.file, decision);
                    Ok(decision.verdict(F::NAME, item.row, &seen.facts))
                },
                Ok,
            )
        });
        verdicts.collect()
    }
}

/// What a filter that judges by facts depends on beside the photo: nothing.
const NO_PARAMS: [u8; 0] = [];

/// Returns the filter's own part of a measure, or why the photo could not be decoded.
fn read<F: Filter>(item: &Measured<'_>) -> Result<Result<F::Measure, String>, StageError> {
    let part = match F::MEASURE {
        // Facts are enough: the measure is empty, and the unit type is JSON's `null`.
        None if item.measure.is_empty() => Ok(&b"null"[..]),
        None => return Err(unreadable(item.row, "it should be empty")),
        Some(_) => survey::part(item.measure, F::NAME, item.row)?,
    };
    let parse = |part| serde_json::from_slice(part).map_err(|error| unreadable(item.row, error));
    part.map(parse)
        .map_or_else(|reason| Ok(Err(reason)), |measure| measure.map(Ok))
}

//! A filter as a stage of a pipeline.

use marf_cache::manifest::Row;
use marf_stage::{
    Ctx, Define, Map, Measure, Measured, PHOTOS, ParamError, Port, Scope, Stage, StageError, Table, VERDICTS,
    Verdict, Work,
};

use crate::filter::{Facts, Filter, MeasuredPhoto, Stored, undecodable};
use crate::survey::{Section, Surveyed, measure_row, measured, tables, unreadable};

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
            table: Table {
                name: F::NAME,
                version: F::MEASURE_VERSION,
            },
            measure: |_, photo| Ok(F::MEASURE.map_or_else(Vec::new, |measure| measure(photo).encode())),
        }),
    };
    #[cfg(test)]
    const GUARD: crate::guard::Guard = F::GUARD;
}

impl<F: Filter> Measure for FilterStage<F> {
    fn table(&self) -> Option<Table> {
        Self::SECTION.map(|section| section.table)
    }

    /// Returns the tables of all filters that measure pixels: one decode fills all.
    fn together(&self) -> Vec<Table> {
        self.table().map_or_else(Vec::new, |_| tables())
    }

    fn measure(&self, ctx: &Ctx<'_>, row: &Row, wanted: &[Table]) -> Result<Vec<Vec<u8>>, StageError> {
        measure_row(ctx, row, wanted)
    }
}

impl<F: Filter> Map for FilterStage<F> {
    fn scope(&self) -> Scope {
        F::scope(&self.params)
    }

    fn decide(&self, items: &[Measured<'_>]) -> Result<Vec<Verdict>, StageError> {
        let mut photos = Vec::with_capacity(items.len());
        let mut refused = Vec::new();
        for (at, item) in items.iter().enumerate() {
            let facts = Facts::of(item.row)?;
            match read_measure::<F>(item)? {
                Ok(measure) => photos.push(MeasuredPhoto {
                    id: item.row.id.as_str(),
                    facts,
                    measure,
                }),
                Err(reason) => refused.push((at, undecodable(item.row, &facts, reason))),
            }
        }
        let by_hand = F::by_hand(&self.params);
        let mut decisions = photos.iter().zip(F::decide(&self.params, &photos));
        let mut refused = refused.into_iter().peekable();
        let mut verdicts = Vec::with_capacity(items.len());
        for (at, item) in items.iter().enumerate() {
            if let Some((_, verdict)) = refused.next_if(|(of, _)| *of == at) {
                verdicts.push(verdict);
                continue;
            }
            let missing = || StageError::new(format!("filter `{}` gave too few decisions", F::NAME));
            let (photo, decision) = decisions.next().ok_or_else(missing)?;
            let decision = by_hand.overrule(photo.id, photo.facts.file, decision);
            verdicts.push(decision.verdict(F::NAME, item.row, &photo.facts));
        }
        Ok(verdicts)
    }
}

/// Reads the measure of one filter; the inner error says why the photo could not be decoded.
fn read_measure<'a, F: Filter>(item: &Measured<'a>) -> Result<Result<F::Measure<'a>, String>, StageError> {
    let part = match F::MEASURE {
        None => Ok(item.measure),
        Some(_) => measured(item.measure, item.row)?,
    };
    let decode = |part| {
        F::Measure::decode(part)
            .ok_or_else(|| unreadable(item.row, format!("it is not of filter `{}`", F::NAME)))
    };
    part.map_or_else(|reason| Ok(Err(reason)), |part| decode(part).map(Ok))
}

use marf_cache::{ContentHash, manifest::Row};
use marf_stage::{
    Ctx, Define, Map, Measure, Measured, PHOTOS, ParamError, Port, Stage, StageError, VERDICTS, Verdict, Work,
};

use crate::filter::{Filter, Seen, Sight, Unreadable, facts_of, undecodable};

/// Inputs of every filter: one set of photos.
pub(crate) const PORTS: &[Port] = &[Port::required("input", PHOTOS)];
/// Outputs of every filter: the photos that stay, and what became of each.
pub(crate) const OUTPUTS: &[&str] = &[PHOTOS, VERDICTS];

/// A [`Filter`] with its parameters, as a stage.
pub struct Judge<F: Filter> {
    params: F::Params,
}

impl<F: Filter> Define for Judge<F> {
    type Params = F::Params;
    const NAME: &'static str = F::NAME;
    const ABOUT: &'static str = F::ABOUT;
    const VERSION: u32 = F::VERSION;
    const PORTS: &'static [Port] = PORTS;
    const OUTPUTS: &'static [&'static str] = OUTPUTS;

    fn new(params: F::Params) -> Result<Self, ParamError> {
        F::check(&params)?;
        Ok(Self { params })
    }
}

impl<F: Filter> Stage for Judge<F> {
    fn params(&self) -> &dyn ContentHash {
        &self.params
    }

    fn work(&self) -> Work<'_> {
        Work::Map(self)
    }
}

impl<F: Filter> Measure for Judge<F> {
    /// No parameter of a filter changes what it measures.
    fn measure_params(&self) -> &dyn ContentHash {
        &NO_PARAMS
    }

    /// Returns JSON: `{"Ok": measure}`, or `{"Err": reason}` for bytes that are no whole photo.
    fn measure(&self, ctx: &Ctx<'_>, row: &Row) -> Result<Vec<u8>, StageError> {
        let measure = match F::measure(&Sight::new(ctx, row)) {
            Ok(measure) => Ok(measure),
            Err(Unreadable::Photo(reason)) => Err(reason),
            Err(Unreadable::Store(error)) => return Err(error),
        };
        serde_json::to_vec(&measure).map_err(|error| {
            StageError::new(format!("measure of `{}` cannot be written", row.id)).cause(error.to_string())
        })
    }
}

impl<F: Filter> Map for Judge<F> {
    fn decide(&self, items: &[Measured<'_>]) -> Result<Vec<Verdict>, StageError> {
        let mut seen = Vec::with_capacity(items.len());
        let mut unread = Vec::with_capacity(items.len());
        for item in items {
            let facts = facts_of(item.row)?;
            match parse::<F::Measure>(item)? {
                Ok(measure) => {
                    unread.push(None);
                    seen.push(Seen {
                        id: item.row.id.clone(),
                        facts,
                        measure,
                    });
                }
                Err(reason) => unread.push(Some(undecodable(item.row, &facts, reason))),
            }
        }
        let opinions = F::decide(&self.params, &seen);
        let mut judged = seen.iter().zip(opinions);
        let verdicts = items.iter().zip(unread).map(|(item, unread)| {
            let missing = || StageError::new(format!("filter `{}` gave too few opinions", F::NAME));
            unread.map_or_else(
                || {
                    let (seen, opinion) = judged.next().ok_or_else(missing)?;
                    Ok(opinion.verdict(F::NAME, item.row, &seen.facts))
                },
                Ok,
            )
        });
        verdicts.collect()
    }
}

/// What a filter's measure depends on beside the photo: nothing.
pub(crate) const NO_PARAMS: [u8; 0] = [];

fn parse<M: serde::de::DeserializeOwned>(item: &Measured<'_>) -> Result<Result<M, String>, StageError> {
    serde_json::from_slice(item.measure).map_err(|error| {
        StageError::new(format!("measure of `{}` cannot be read", item.row.id))
            .cause(error.to_string())
            .hint("run `marf cache fsck`: the store may be damaged")
    })
}

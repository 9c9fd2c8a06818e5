//! A stage that compares photos with each other in two passes.

use std::sync::Arc;

use marf_cache::manifest::Row;
use marf_stage::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{
    fixture::{FixtureId, fixture},
    stages::{Keeps, measure_number, read, verdict},
};

/// Rejects the numbers of the highest ten that any photo is in, unless at least `enough` photos are in it.
pub struct Crowd(CrowdParams);

#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CrowdParams {
    pub fixture: FixtureId,
    pub enough: u64,
}

impl Define for Crowd {
    type Params = CrowdParams;
    const NAME: &'static str = "crowd";
    const ABOUT: &'static str = "a stage of a test";
    const VERSION: u32 = 1;
    const PORTS: &'static [Port] = &[Port::required("input", PHOTOS)];
    const OUTPUTS: &'static [&'static str] = &[PHOTOS, VERDICTS];

    fn new(params: CrowdParams) -> Result<Self, ParamError> {
        Ok(Self(params))
    }
}

impl Stage for Crowd {
    fn params(&self) -> serde_json::Value {
        key_params(&self.0, &["fixture"])
    }

    fn work(&self) -> Work<'_> {
        Work::Map(self)
    }
}

impl Measure for Crowd {
    fn table(&self) -> Option<Table> {
        Some(Table {
            name: "crowd",
            version: 1,
        })
    }

    fn measure(&self, ctx: &Ctx<'_>, row: &Row, _wanted: &[Table]) -> Result<Vec<Vec<u8>>, StageError> {
        Ok(vec![measure_number(self.0.fixture.0, ctx, row)?])
    }
}

/// The highest ten, followed after the second pass by whether it has enough photos.
type Found = (u64, Option<bool>);

fn found(context: &[u8]) -> Found {
    serde_json::from_slice(context).unwrap()
}

impl Map for Crowd {
    fn comparison(&self) -> Option<&dyn Comparison> {
        Some(self)
    }

    fn decide(&self, context: &[u8], items: &[Measured<'_>]) -> Result<Vec<Verdict>, StageError> {
        let (highest, is_enough) = found(context);
        let decide = |item: &Measured<'_>| {
            let keeps = is_enough.unwrap() || read(item.measure) / 10 < highest;
            verdict(&item.row.id, Keeps(keeps), Some(highest as f64))
        };
        Ok(items.iter().map(decide).collect())
    }
}

impl Comparison for Crowd {
    fn passes(&self) -> Vec<&'static str> {
        vec!["highest", "crowd"]
    }

    fn summarise(&self, pass: usize, context: &[u8], items: &[Measured<'_>]) -> Result<Vec<u8>, StageError> {
        let tens = items.iter().map(|item| read(item.measure) / 10);
        let number = match pass {
            0 => tens.max().unwrap_or(0),
            _ => tens.filter(|ten| *ten == found(context).0).count() as u64,
        };
        Ok(number.to_le_bytes().to_vec())
    }

    fn context(
        &self,
        pass: usize,
        context: &[u8],
        summaries: &mut dyn Iterator<Item = Result<Arc<[u8]>, StageError>>,
    ) -> Result<Vec<u8>, StageError> {
        let at_context = fixture(self.0.fixture.0).at_context.lock().clone();
        if let Some(at_context) = at_context {
            at_context(pass);
        }
        let numbers: Result<Vec<u64>, StageError> = summaries.map(|summary| Ok(read(&summary?))).collect();
        let numbers = numbers?;
        let found: Found = match pass {
            0 => (numbers.into_iter().max().unwrap_or(0), None),
            _ => (
                found(context).0,
                Some(numbers.into_iter().sum::<u64>() >= self.0.enough),
            ),
        };
        Ok(serde_json::to_vec(&found).unwrap())
    }
}

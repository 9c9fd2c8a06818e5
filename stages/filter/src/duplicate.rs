//! The filter `duplicate`.

mod fold;
mod nearest;
mod photo;
mod rule;

use marf_stage::{Define, Fold, FoldState, ParamError, Port, Stage, Table, Work};

use crate::bytes::to_bytes;
use crate::descriptor::ViewDescriptor;
use crate::filter::check_range;
#[cfg(test)]
use crate::section::Guard;
use crate::section::{Section, Surveyed};
use crate::stage::{OUTPUTS, PORTS};
use fold::DuplicateState;
pub(crate) use rule::Duplicate;
use rule::DuplicateParams;

impl Define for Duplicate {
    type Params = DuplicateParams;
    const NAME: &'static str = "duplicate";
    const ABOUT: &'static str = "rejects photos that show the same view as a better one";
    const VERSION: u32 = Self::MEASURE_VERSION + Self::DECISION_VERSION;
    const RELAX: Option<&'static str> = Some("a higher `min_correlation`");
    const PORTS: &'static [Port] = PORTS;
    const OUTPUTS: &'static [&'static str] = OUTPUTS;

    fn new(params: DuplicateParams) -> Result<Self, ParamError> {
        check_range("candidate_bits", f64::from(params.candidate_bits), 0.0, 64.0)?;
        check_range("max_bits", f64::from(params.max_bits), 0.0, 65.0)?;
        check_range("min_correlation", params.min_correlation, -1.0, 1.0)?;
        check_range("filter_correlation", params.filter_correlation, -1.0, 1.0)?;
        check_range("version_correlation", params.version_correlation, -1.0, 1.0)?;
        params.by_hand.check()?;
        Ok(Self { params })
    }
}

impl Stage for Duplicate {
    fn params(&self) -> serde_json::Value {
        marf_stage::key_params(&self.params, &[])
    }

    fn work(&self) -> Work<'_> {
        Work::Fold(self)
    }
}

impl Surveyed for Duplicate {
    const SECTION: Option<Section> = Some(Section {
        table: Self::TABLE,
        measure: |ctx, photo| {
            let (descriptor, planes) = ViewDescriptor::from_photo(photo);
            ctx.put(&planes)?;
            to_bytes(&descriptor)
        },
    });
    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "4 92a2e5b74dcb",
        decisions: "5 8a7685578a5e",
    };
}

impl Fold for Duplicate {
    fn begin(&self) -> Box<dyn FoldState + '_> {
        Box::new(DuplicateState::new(self))
    }
}

impl Duplicate {
    /// As [`Filter::MEASURE_VERSION`](crate::Filter::MEASURE_VERSION).
    const MEASURE_VERSION: u32 = 4;
    /// As [`Filter::DECISION_VERSION`](crate::Filter::DECISION_VERSION).
    const DECISION_VERSION: u32 = 1;

    /// Where its measures are kept.
    pub(crate) const TABLE: Table = Table {
        name: Self::NAME,
        version: Self::MEASURE_VERSION,
    };
}

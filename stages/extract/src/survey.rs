//! What is measured of photos while they are decoded.

use marf_scene::Photo;
use marf_stage::{Ctx, StageError, Table};

/// Measures a photo for each of some tables, in their order.
pub type MeasurePhoto = fn(&Ctx<'_>, &Photo, &[Table]) -> Result<Vec<Vec<u8>>, StageError>;

/// Measures of other stages that are made of every photo while it is in memory, so that it is decoded once.
pub trait Survey: Send + Sync + 'static {
    /// Returns the tables that can be filled.
    fn tables() -> Vec<Table>;

    /// Measures a photo. Returns the results of [`marf_stage::Measure::measure`] of the stages that read the tables,
    /// for a row whose blob `image` decodes to this photo. Fails only if the whole shard does.
    const MEASURE: MeasurePhoto;
}

/// Measures nothing.
pub struct NoSurvey;

impl Survey for NoSurvey {
    fn tables() -> Vec<Table> {
        Vec::new()
    }

    const MEASURE: MeasurePhoto = |_, _, _| Ok(Vec::new());
}

/// What is measured of each photo: some tables of a survey.
#[derive(Clone)]
pub(crate) struct PhotoMeasures {
    pub(crate) tables: Vec<Table>,
    pub(crate) measure: MeasurePhoto,
}

impl PhotoMeasures {
    /// Returns those tables of a survey that are among `tables`.
    pub(crate) fn new<S: Survey>(tables: &[Table]) -> Self {
        let mut chosen = S::tables();
        chosen.retain(|table| tables.contains(table));
        Self {
            tables: chosen,
            measure: S::MEASURE,
        }
    }
}

//! The kinds of work: how a node is computed when its key is not in the store.

mod compare;
mod expand;
mod extent;
mod fold;
mod map;
mod measure;
mod shards;
mod source;
mod stage_run;

use crate::listing::SourceListing;
use marf_stage::{NodeSpec, Outputs, StageError, Work};

pub(crate) use expand::after_round;
pub use extent::Extent;
pub(crate) use extent::extent;
pub(crate) use stage_run::{
    BlobCheck, Counts, PartedOutputs, StageRun, needs_of, put_action, put_needs, put_parts, with_lengths,
};

/// The result of a stage.
pub(crate) enum StageOutcome {
    /// Its outputs, and of a source the listing that they are of.
    Outputs(PartedOutputs, Option<SourceListing>),
    /// Child nodes that must run first.
    Children(Vec<NodeSpec>),
}

/// Runs a stage.
pub(crate) fn execute(run: &StageRun<'_>) -> Result<StageOutcome, StageError> {
    match run.stage.work() {
        Work::Source(source) => {
            source::execute(run, source).map(|(outputs, listed)| StageOutcome::Outputs(outputs, listed))
        }
        Work::Map(map) => map::execute(run, map).map(alone),
        Work::Fold(fold) => fold::execute(run, fold).map(alone),
        Work::Set(set) => Ok(alone(set.run(&run.ctx, run.inputs)?.into())),
        Work::Expand(expand) => Ok(StageOutcome::Children(expand.expand(&run.ctx, run.inputs)?)),
    }
}

fn alone(outputs: PartedOutputs) -> StageOutcome {
    StageOutcome::Outputs(outputs, None)
}

/// Outputs of a node without parts and figures.
impl From<Outputs> for PartedOutputs {
    fn from(outputs: Outputs) -> Self {
        Self {
            outputs,
            counts: Counts::new(),
            parts: Vec::new(),
        }
    }
}

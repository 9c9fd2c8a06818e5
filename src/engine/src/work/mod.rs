//! The kinds of work: what a node does when its key is not in the store.

mod expand;
mod fold;
mod map;
mod measure;
mod source;
mod stage_run;

use marf_stage::{NodeSpec, Outputs, StageError, Work};

pub(crate) use expand::reduce;
pub(crate) use stage_run::{BlobCheck, Counts, StageRun, with_lengths};

/// What a stage gave.
pub(crate) enum Produced {
    /// Outputs, and figures of the work.
    Outputs(Outputs, Counts),
    /// Child nodes that must run first.
    Children(Vec<NodeSpec>),
}

/// Runs a stage.
pub(crate) fn execute(run: &StageRun<'_>) -> Result<Produced, StageError> {
    let outputs = |(outputs, counts)| Produced::Outputs(outputs, counts);
    match run.stage.work() {
        Work::Source(source) => source::execute(run, source).map(outputs),
        Work::Map(map) => map::execute(run, map).map(outputs),
        Work::Fold(fold) => fold::execute(run, fold).map(outputs),
        Work::Set(set) => Ok(outputs((set.run(&run.ctx, run.inputs)?, Counts::new()))),
        Work::Expand(expand) => Ok(Produced::Children(expand.expand(&run.ctx, run.inputs)?)),
    }
}

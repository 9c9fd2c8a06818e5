//! Expansion: the second half, when all nodes asked for have their outputs.

use marf_stage::{Outputs, StageError, Work};

use super::{Counts, Job};
use crate::photos::bug;

/// Reduces the outputs of the nodes that were asked for, in the order they were asked for.
pub(crate) fn reduce(job: &Job<'_>, children: &[Outputs]) -> Result<(Outputs, Counts), StageError> {
    let Work::Expand(expand) = job.stage.work() else {
        return Err(bug("a stage that expanded does not reduce".to_owned()));
    };
    let counts = Counts::from([("children".to_owned(), children.len() as u64)]);
    Ok((expand.reduce(&job.ctx, job.inputs, children)?, counts))
}

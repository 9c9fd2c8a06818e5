//! The second half of an expansion: the reduction of the children's outputs.

use marf_stage::{Outputs, StageError, Work};

use super::stage_run::{Counts, StageRun};
use crate::errors::contract_violation;

/// Reduces the outputs of the children, given in the order of the expansion.
pub(crate) fn reduce(run: &StageRun<'_>, children: &[Outputs]) -> Result<(Outputs, Counts), StageError> {
    let Work::Expand(expand) = run.stage.work() else {
        return Err(contract_violation(
            "a stage that expanded does not reduce".to_owned(),
        ));
    };
    let counts = Counts::from([("children".to_owned(), children.len() as u64)]);
    Ok((expand.reduce(&run.ctx, run.inputs, children)?, counts))
}

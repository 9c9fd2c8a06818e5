//! The second half of an expansion: the reduction of the children's outputs.

use marf_stage::{Outputs, StageError, Work};

use super::stage_run::{Counts, PartedOutputs, StageRun};
use crate::errors::contract_violation;

/// Reduces the outputs of the children, given in the order of the expansion.
pub(crate) fn reduce(run: &StageRun<'_>, children: &[Outputs]) -> Result<PartedOutputs, StageError> {
    let Work::Expand(expand) = run.stage.work() else {
        return Err(contract_violation(
            "a stage that expanded does not reduce".to_owned(),
        ));
    };
    let outputs = expand.reduce(&run.ctx, run.inputs, children)?;
    Ok(PartedOutputs {
        counts: Counts::from([("children".to_owned(), children.len() as u64)]),
        ..outputs.into()
    })
}

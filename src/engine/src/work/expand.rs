//! What follows when the children of an expansion have run: a further round of them, or the reduction of their outputs.

use marf_stage::{Outputs, StageError, Work};

use super::StageOutcome;
use super::stage_run::{Counts, PartedOutputs, StageRun};
use crate::errors::contract_violation;

/// Returns the children of the next round, or the outputs if there is none. `done` holds the outputs of the children so far,
/// in the order of the requests.
pub(crate) fn after_round(run: &StageRun<'_>, done: &[Outputs]) -> Result<StageOutcome, StageError> {
    let Work::Expand(expand) = run.stage.work() else {
        return Err(contract_violation(
            "a stage that expanded does not reduce".to_owned(),
        ));
    };
    let further = expand.further(&run.ctx, run.inputs, done)?;
    if !further.is_empty() {
        return Ok(StageOutcome::Children(further));
    }
    let outputs = expand.reduce(&run.ctx, run.inputs, done)?;
    let outputs = PartedOutputs {
        counts: Counts::from([("children".to_owned(), done.len() as u64)]),
        ..outputs.into()
    };
    Ok(StageOutcome::Outputs(outputs, None))
}

//! One part of a node as an action of its own: from its inputs alone, without results of earlier runs.

use marf_stage::{StageError, Work};

use super::{
    compare, elsewhere, fold, map,
    stage_run::{PartKind, StageRun},
};
use crate::{errors::contract_violation, items::ShardLeaves};

/// Makes a part of a node and stores its record with the next commit. The key and the inputs of the run are those of the part.
pub(crate) fn make_part(run: &StageRun<'_>, kind: PartKind, shard: &ShardLeaves) -> Result<(), StageError> {
    match (kind, run.stage.work()) {
        (PartKind::Measure, Work::Map(map)) => elsewhere::measure_part(run, map, shard),
        (PartKind::Measure, Work::Fold(fold)) => elsewhere::measure_part(run, fold, shard),
        (PartKind::Summarise(pass), Work::Map(map)) => compare::summarise(run, map, pass, shard),
        (PartKind::Decide, Work::Map(map)) => map::decide(run, map, shard),
        (PartKind::Fold, Work::Fold(fold)) => fold::step(run, fold, shard),
        _ => Err(contract_violation(format!("it has no part `{}`", kind.name()))),
    }
}

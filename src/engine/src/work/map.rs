//! Maps: a measure for each row, then one decision over the whole set.

use marf_cache::manifest::Root;
use marf_stage::{Map, Measured, Outputs, PHOTOS, StageError, VERDICTS, Verdict};

use super::{
    measure::measure,
    stage_run::{Counts, StageRun},
};
use crate::{
    errors::contract_violation,
    items::{ShardRows, kept, read_all_shards, write_shard, write_verdicts},
};

/// Measures the rows of all shards, decides, and keeps the rows that the decision keeps.
pub(super) fn execute(run: &StageRun<'_>, map: &dyn Map) -> Result<(Outputs, Counts), StageError> {
    let shards = read_all_shards(&run.ctx, run.inputs.required(PHOTOS)?)?;
    let measures = measure(run, map, &shards)?;
    let items: Vec<Measured<'_>> = (0..shards.len())
        .flat_map(|index| measures.items(&shards, index))
        .collect();
    let verdicts = map.decide(&items)?;
    if verdicts.len() != items.len() {
        let (got, wanted) = (verdicts.len(), items.len());
        return Err(contract_violation(format!(
            "{got} verdicts came for {wanted} photos"
        )));
    }
    drop(items);
    let mut leaves = Vec::new();
    let mut rest = verdicts.as_slice();
    for part in shards {
        let (own, others) = rest.split_at(part.rows.len());
        rest = others;
        let rows = kept(part.rows, own)?;
        leaves.extend(write_shard(&run.ctx, ShardRows { rows, ..part })?);
    }
    outputs(run, Root { leaves }, verdicts, measures.measured)
}

/// Stores the rows kept and all verdicts, and returns them with the figures of the work.
pub(super) fn outputs(
    run: &StageRun<'_>,
    root: Root,
    verdicts: Vec<Verdict>,
    measured: u64,
) -> Result<(Outputs, Counts), StageError> {
    let rejected = verdicts.iter().filter(|verdict| !verdict.keeps()).count() as u64;
    let counts = [
        ("photos", root.rows()),
        ("rejected", rejected),
        ("measured", measured),
    ];
    let outputs = [
        (PHOTOS, run.ctx.put(&root.encode())?),
        (VERDICTS, write_verdicts(&run.ctx, verdicts)?),
    ];
    Ok((
        outputs
            .into_iter()
            .map(|(name, digest)| (name.to_owned(), digest))
            .collect(),
        counts
            .into_iter()
            .map(|(name, count)| (name.to_owned(), count))
            .collect(),
    ))
}

//! Maps: measures by row, then one decision over the whole set.

use marf_cache::manifest::Root;
use marf_stage::{Map, Measured, Outputs, PHOTOS, StageError, VERDICTS, Verdict};

use super::{Counts, Job, measure::measure};
use crate::photos::{Part, bug, kept, read_parts, write_part, write_verdicts};

pub(super) fn perform(job: &Job<'_>, map: &dyn Map) -> Result<(Outputs, Counts), StageError> {
    let parts = read_parts(&job.ctx, job.inputs.required(PHOTOS)?)?;
    let measures = measure(job, map, &parts)?;
    let items: Vec<Measured<'_>> = (0..parts.len())
        .flat_map(|index| measures.items(&parts, index))
        .collect();
    let verdicts = map.decide(&items)?;
    if verdicts.len() != items.len() {
        let (got, wanted) = (verdicts.len(), items.len());
        return Err(bug(format!("{got} verdicts came for {wanted} photos")));
    }
    drop(items);
    let mut leaves = Vec::new();
    let mut rest = verdicts.as_slice();
    for part in parts {
        let (own, others) = rest.split_at(part.rows.len());
        rest = others;
        let rows = kept(part.rows, own)?;
        leaves.extend(write_part(&job.ctx, Part { rows, ..part })?);
    }
    outputs(job, Root { leaves }, verdicts, measures.measured)
}

/// Stores the set that stays and the verdicts on all.
pub(super) fn outputs(
    job: &Job<'_>,
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
        (PHOTOS, job.ctx.put(&root.encode())?),
        (VERDICTS, write_verdicts(&job.ctx, verdicts)?),
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

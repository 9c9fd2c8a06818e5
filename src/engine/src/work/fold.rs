//! Folds: a state goes from shard to shard, one record a step, so a new shard continues from the last state.

use std::collections::BTreeMap;

use marf_cache::{
    ContentHash, Digest,
    manifest::{LeafRef, Root},
};
use marf_stage::{Fold, Outputs, PHOTOS, StageError, VERDICTS};

use super::{
    Counts, Job, map,
    measure::{Measures, measure},
};
use crate::photos::{Part, by_shard, kept, read_part, read_root, read_verdicts, write_part, write_verdicts};

const STATE: &str = "state";

/// What a step depends on beside stage and parameters.
#[derive(ContentHash)]
struct Step {
    shard: u32,
    state: Option<Digest>,
    leaves: Vec<Digest>,
}

/// What a step gave.
struct Stepped {
    state: Digest,
    root: Digest,
    verdicts: Digest,
}

pub(super) fn perform(job: &Job<'_>, fold: &dyn Fold) -> Result<(Outputs, Counts), StageError> {
    let shards = by_shard(&read_root(&job.ctx, job.inputs.required(PHOTOS)?)?);
    let mut rest = Rest::default();
    let mut state = None;
    let mut leaves = Vec::new();
    let mut verdicts = Vec::new();
    for (index, (shard, refs)) in shards.iter().enumerate() {
        job.ctx.check()?;
        let step = Step {
            shard: *shard,
            state,
            leaves: refs.iter().map(|leaf| leaf.leaf).collect(),
        };
        let params = (fold.measure_params(), job.stage.params());
        let key = job.part_key("fold", &params, &step);
        let stepped = match job.part_hit(&key)? {
            Some(record) => Stepped {
                state: record.outputs[STATE].digest,
                root: record.outputs[PHOTOS].digest,
                verdicts: record.outputs[VERDICTS].digest,
            },
            None => {
                rest.measure_from(job, fold, &shards, index)?;
                let stepped = rest.step(job, fold, index, state)?;
                job.put_part(key, stepped.outputs())?;
                stepped
            }
        };
        state = Some(stepped.state);
        leaves.extend(read_root(&job.ctx, &stepped.root)?.leaves);
        verdicts.extend(read_verdicts(&job.ctx, &stepped.verdicts)?);
    }
    map::outputs(job, Root { leaves }, verdicts, rest.measured())
}

impl Stepped {
    fn outputs(&self) -> Outputs {
        BTreeMap::from([
            (STATE.to_owned(), self.state),
            (PHOTOS.to_owned(), self.root),
            (VERDICTS.to_owned(), self.verdicts),
        ])
    }
}

/// The shards from the first new step on, measured together so that all threads have work.
#[derive(Default)]
struct Rest {
    first: usize,
    parts: Vec<Part>,
    measures: Option<Measures>,
}

impl Rest {
    fn measure_from(
        &mut self,
        job: &Job<'_>,
        fold: &dyn Fold,
        shards: &[(u32, Vec<LeafRef>)],
        first: usize,
    ) -> Result<(), StageError> {
        if self.measures.is_some() {
            return Ok(());
        }
        let parts = shards[first..].iter();
        let parts: Result<Vec<Part>, _> = parts
            .map(|(shard, leaves)| read_part(&job.ctx, *shard, leaves))
            .collect();
        self.first = first;
        self.parts = parts?;
        self.measures = Some(measure(job, fold, &self.parts)?);
        Ok(())
    }

    fn step(
        &self,
        job: &Job<'_>,
        fold: &dyn Fold,
        index: usize,
        state: Option<Digest>,
    ) -> Result<Stepped, StageError> {
        let at = index - self.first;
        let items = self
            .measures
            .as_ref()
            .map(|measures| measures.items(&self.parts, at));
        let before = state.map(|state| job.ctx.get(&state)).transpose()?;
        let (after, verdicts) = fold.fold(before.as_deref(), &items.unwrap_or_default())?;
        let part = &self.parts[at];
        let rows = kept(part.rows.clone(), &verdicts)?;
        let leaves = write_part(
            &job.ctx,
            Part {
                shard: part.shard,
                rows,
            },
        )?;
        Ok(Stepped {
            state: job.ctx.put(&after)?,
            root: job.ctx.put(&Root { leaves }.encode())?,
            verdicts: write_verdicts(&job.ctx, verdicts)?,
        })
    }

    fn measured(&self) -> u64 {
        self.measures.as_ref().map_or(0, |measures| measures.measured)
    }
}

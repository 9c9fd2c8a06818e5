//! Folds: a state is passed from shard to shard. Each step has its record, so a new shard continues from the last
//! state.

use std::collections::BTreeMap;

use marf_cache::{
    ContentHash, Digest,
    manifest::{LeafRef, Root},
};
use marf_stage::{Fold, Outputs, PHOTOS, StageError, VERDICTS};

use super::{
    map,
    measure::{Measures, measure},
    stage_run::{Counts, StageRun},
};
use crate::items::{
    ShardRows, by_shard, kept, read_root, read_shard, read_verdicts, write_shard, write_verdicts,
};

const STATE: &str = "state";

/// What a step depends on besides stage and parameters; part of its key.
#[derive(ContentHash)]
#[content_hash(name = "Step")]
struct StepContent {
    shard: u32,
    state: Option<Digest>,
    leaves: Vec<Digest>,
}

/// The outputs of a step.
struct StepOutputs {
    state: Digest,
    root: Digest,
    verdicts: Digest,
}

/// Runs a fold over all shards, from the first whose step has no record.
pub(super) fn execute(run: &StageRun<'_>, fold: &dyn Fold) -> Result<(Outputs, Counts), StageError> {
    let shards = by_shard(&read_root(&run.ctx, run.inputs.required(PHOTOS)?)?);
    let mut new = NewShards::default();
    let mut state = None;
    let mut leaves = Vec::new();
    let mut verdicts = Vec::new();
    for (index, (shard, refs)) in shards.iter().enumerate() {
        run.ctx.check()?;
        let step = StepContent {
            shard: *shard,
            state,
            leaves: refs.iter().map(|leaf| leaf.leaf).collect(),
        };
        let params = (fold.measure_params(), run.stage.params());
        let key = run.part_key("fold", &params, &step);
        let outputs = match run.part_hit(&key)? {
            Some(record) => StepOutputs {
                state: record.outputs[STATE].digest,
                root: record.outputs[PHOTOS].digest,
                verdicts: record.outputs[VERDICTS].digest,
            },
            None => {
                new.measure_from(run, fold, &shards, index)?;
                let outputs = new.step(run, fold, index, state)?;
                run.put_part(key, outputs.by_name())?;
                outputs
            }
        };
        state = Some(outputs.state);
        leaves.extend(read_root(&run.ctx, &outputs.root)?.leaves);
        verdicts.extend(read_verdicts(&run.ctx, &outputs.verdicts)?);
    }
    map::outputs(run, Root { leaves }, verdicts, new.measured())
}

impl StepOutputs {
    /// Returns the outputs by name, for the record of the step.
    fn by_name(&self) -> Outputs {
        BTreeMap::from([
            (STATE.to_owned(), self.state),
            (PHOTOS.to_owned(), self.root),
            (VERDICTS.to_owned(), self.verdicts),
        ])
    }
}

/// The shards from the first new one on, measured together so that all threads have work.
#[derive(Default)]
struct NewShards {
    first: usize,
    shards: Vec<ShardRows>,
    measures: Option<Measures>,
}

impl NewShards {
    /// Reads and measures the shards from `first` on, once.
    fn measure_from(
        &mut self,
        run: &StageRun<'_>,
        fold: &dyn Fold,
        shards: &[(u32, Vec<LeafRef>)],
        first: usize,
    ) -> Result<(), StageError> {
        if self.measures.is_some() {
            return Ok(());
        }
        let new: Result<Vec<ShardRows>, _> = shards[first..]
            .iter()
            .map(|(shard, leaves)| read_shard(&run.ctx, *shard, leaves))
            .collect();
        self.first = first;
        self.shards = new?;
        self.measures = Some(measure(run, fold, &self.shards)?);
        Ok(())
    }

    /// Folds one shard into the state and stores what comes out.
    fn step(
        &self,
        run: &StageRun<'_>,
        fold: &dyn Fold,
        index: usize,
        state: Option<Digest>,
    ) -> Result<StepOutputs, StageError> {
        let at = index - self.first;
        let items = self
            .measures
            .as_ref()
            .map(|measures| measures.items(&self.shards, at));
        let before = state.map(|state| run.ctx.get(&state)).transpose()?;
        let (after, verdicts) = fold.fold(before.as_deref(), &items.unwrap_or_default())?;
        let part = &self.shards[at];
        let rows = kept(part.rows.clone(), &verdicts)?;
        let leaves = write_shard(
            &run.ctx,
            ShardRows {
                shard: part.shard,
                rows,
            },
        )?;
        Ok(StepOutputs {
            state: run.ctx.put(&after)?,
            root: run.ctx.put(&Root { leaves }.encode())?,
            verdicts: write_verdicts(&run.ctx, verdicts)?,
        })
    }

    fn measured(&self) -> u64 {
        self.measures.as_ref().map_or(0, |measures| measures.measured)
    }
}

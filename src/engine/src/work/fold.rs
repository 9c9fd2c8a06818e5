//! Folds: a state grows from shard to shard. Each step has its record with its addition, so a new shard continues from the additions of the
//! earlier ones.

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_stage::{Ctx, Fold, FoldState, PHOTOS, StageError};

use super::{
    map::store_decided,
    measure::{MeasuredShard, RowProgress, measure, windows},
    stage_run::{Counts, Part, PartKind, PartedOutputs, StageRun},
};
use crate::{
    errors::contract_violation,
    items::{ShardLeaves, by_shard, read_set},
    key::Key,
    stage_io::StoreBlobs,
};

/// Name of the input of a step that represents the additions of all earlier steps.
const BEFORE: &str = "before";

/// The chain before the first step.
pub(super) fn start() -> Digest {
    Digest::from_content(&[])
}

/// Returns the chain after a step, from the chain before it and the addition of the step.
pub(super) fn after(before: &Digest, added: &Digest) -> Digest {
    Digest::from_content(&link(before, added))
}

/// Returns the last link of a chain: the digest of the chain before a step, and that of the step's addition.
fn link(before: &Digest, added: &Digest) -> Vec<u8> {
    [*before.as_bytes(), *added.as_bytes()].concat()
}

/// Returns the inputs of the step that folds a shard into the state after a chain of steps.
pub(super) fn step_inputs(shard: &ShardLeaves, before: Digest) -> BTreeMap<String, Digest> {
    let before = (BEFORE.to_owned(), before);
    shard.inputs().into_iter().chain([before]).collect()
}

/// Runs a fold over all shards, from the first whose step has no record.
pub(super) fn execute(run: &StageRun<'_>, fold: &dyn Fold) -> Result<PartedOutputs, StageError> {
    let shards = by_shard(&read_set(&run.ctx, run.inputs.required(PHOTOS)?)?);
    let mut steps = Steps {
        run,
        keys: Vec::new(),
        parts: Vec::new(),
        before: start(),
    };
    let first = steps.reuse(&shards)?;
    let mut state = fold.begin();
    if first < shards.len() {
        replay(
            run,
            state.as_mut(),
            steps.parts.iter().filter_map(|part| part.added),
        )?;
    }
    let total: u64 = shards[first..].iter().map(|shard| shard.rows()).sum();
    let mut measured = 0;
    let mut progress = RowProgress::new(run, total);
    for window in windows(&shards[first..], |shard| shard.rows()) {
        let leaves: Vec<&ShardLeaves> = window.iter().collect();
        let read = measure(run, fold, &leaves, &mut progress)?;
        measured += read.measured;
        for (leaves, shard) in window.iter().zip(read.shards) {
            run.ctx.check()?;
            steps.fold(fold, state.as_mut(), leaves, shard)?;
        }
    }
    let counts = Counts::from([
        ("measured".to_owned(), measured),
        ("decided".to_owned(), (shards.len() - first) as u64),
    ]);
    let keys = shards
        .iter()
        .zip(&steps.keys)
        .map(|(shard, key)| (shard.shard, *key));
    run.join(keys.collect(), steps.parts.into_iter().collect(), counts)
}

/// Brings a state to where the steps that added this left it.
fn replay(
    run: &StageRun<'_>,
    state: &mut dyn FoldState,
    added: impl IntoIterator<Item = Digest>,
) -> Result<(), StageError> {
    for added in added {
        run.ctx.check()?;
        state.replay(&run.ctx, &run.ctx.get(&added)?)?;
    }
    Ok(())
}

/// The steps so far.
struct Steps<'a> {
    run: &'a StageRun<'a>,
    keys: Vec<Digest>,
    parts: Vec<Part>,
    /// Digest of the chain of all that was added.
    before: Digest,
}

impl Steps<'_> {
    fn key(&self, shard: &ShardLeaves) -> Key {
        self.run
            .part_key(PartKind::Fold, shard.shard, step_inputs(shard, self.before))
    }

    /// Takes the steps that have a record, up to the first without. Returns their number.
    fn reuse(&mut self, shards: &[ShardLeaves]) -> Result<usize, StageError> {
        for (index, shard) in shards.iter().enumerate() {
            self.run.ctx.check()?;
            let key = self.key(shard);
            match self.run.part_hit(&key.digest)? {
                Some(part) => self.push(key.digest, part)?,
                None => return Ok(index),
            }
        }
        Ok(shards.len())
    }

    /// Folds one shard into the state and stores the results.
    fn fold(
        &mut self,
        fold: &dyn Fold,
        state: &mut dyn FoldState,
        leaves: &ShardLeaves,
        shard: MeasuredShard,
    ) -> Result<(), StageError> {
        let key = self.key(leaves);
        let blobs = StoreBlobs::new(self.run.store);
        let ctx: Ctx<'_> = self.run.with_blobs(&blobs);
        let (added, verdicts) = {
            let items = shard.items();
            let (added, verdicts) = state.fold(&ctx, &items)?;
            // The blobs of measures are needed by this step and by those that come back to it.
            let measured = items.iter().flat_map(|item| fold.blobs(item.measure));
            blobs.note(measured.chain(state.blobs(&added)));
            (added, verdicts)
        };
        let added = ctx.put(&added)?;
        // The inputs of an action are in the store, and this is one of the next step.
        ctx.put(&link(&self.before, &added))?;
        let part = Part {
            added: Some(added),
            ..store_decided(&ctx, shard.rows, verdicts)?
        };
        self.run.put_part(&key, &part, &blobs)?;
        self.push(key.digest, part)
    }

    fn push(&mut self, key: Digest, part: Part) -> Result<(), StageError> {
        let added = part
            .added
            .ok_or_else(|| contract_violation("a step of a fold has no output `added`".to_owned()))?;
        self.before = after(&self.before, &added);
        self.keys.push(key);
        self.parts.push(part);
        Ok(())
    }
}

//! A part of a node as an action of its own. A machine computes it for a map or a fold that runs elsewhere or is recomputed.

use std::{collections::BTreeMap, time::Instant};

use marf_cache::{Action, Record, RunMetadata, Store, manifest::LeafRef};
use marf_stage::{Cancel, Ctx, Inputs, Stage, StageError, Work};

use super::{error::ActionError, job::unix_seconds, task::Task};
use crate::{
    event::{Event, Listener, NodeProgress},
    items::{ShardLeaves, leaf_name},
    key::Key,
    stage_io::{FileCheckpoints, StoreBlobs, StoreMemos},
    work::{BlobCheck, PASS, PartKind, StageRun, make_part},
};

/// Returns the name of the pass for which an action summarises its shard. None for other actions.
pub(super) fn pass_of(action: &Action) -> Option<&str> {
    let name = PartKind::Summarise("").name();
    let is_summary = action.part.as_deref() == Some(name);
    action.params.get(PASS).filter(|_| is_summary)?.as_str()
}

/// Returns the kind of part of a stage that an action is, with its shard. None if the stage has no such part.
pub(super) fn part_of(action: &Action, stage: &dyn Stage) -> Option<(PartKind, ShardLeaves)> {
    let named = action.part.as_deref()?;
    let kinds: Vec<PartKind> = match stage.work() {
        Work::Map(map) => {
            let passes = map.comparison().map(|comparison| comparison.passes());
            let own = |pass: &&str| Some(*pass) == pass_of(action);
            let passes = passes.unwrap_or_default().into_iter().filter(own);
            let summaries = passes.map(PartKind::Summarise);
            summaries.chain([PartKind::Decide, PartKind::Measure]).collect()
        }
        Work::Fold(_) => vec![PartKind::Fold, PartKind::Measure],
        _ => Vec::new(),
    };
    let kind = kinds.into_iter().find(|kind| kind.name() == named)?;
    let shard = action.shard?;
    let leaf = |number: usize| action.inputs.get(&leaf_name(number)).copied();
    let leaves = (0..).map_while(leaf).map(|leaf| LeafRef { shard, leaf, rows: 0 });
    let leaves = leaves.collect();
    Some((kind, ShardLeaves { shard, leaves }))
}

/// A part of a node as an action of its own.
pub(super) struct PartJob<'a> {
    pub(super) task: &'a Task,
    pub(super) kind: PartKind,
    pub(super) shard: ShardLeaves,
    pub(super) store: &'a Store,
    pub(super) program: &'a str,
    pub(super) threads: usize,
}

impl PartJob<'_> {
    /// Makes the part, unless that is done, and returns the record.
    pub(super) fn run(&self, listener: &dyn Listener, cancel: &Cancel) -> Result<Record, ActionError> {
        let lost = || ActionError::Failed("its result was lost".to_owned());
        let key = &self.task.prepared.as_ref().ok_or_else(lost)?.key;
        if self.store.hit(&key.digest)?.is_none() {
            let made = self.make(key, listener, cancel);
            made.map_err(|error| self.told(error, listener))?;
            self.store.commit()?;
        }
        self.store.record(&key.digest)?.ok_or_else(lost)
    }

    /// Reports to the listener why there is no result.
    fn told(&self, error: StageError, listener: &dyn Listener) -> ActionError {
        let (message, cause, hint) = match error {
            StageError::Cancelled => return ActionError::Stopped,
            StageError::Failed { message, cause, hint } => (message, cause, hint),
            StageError::Blob(error) => (error.message, None, None),
        };
        listener.on_event(&Event::Failed {
            node: self.task.name.clone(),
            message: message.clone(),
            cause,
            hint,
        });
        ActionError::Failed(message)
    }

    fn make(&self, key: &Key, listener: &dyn Listener, cancel: &Cancel) -> Result<(), StageError> {
        let (store, name) = (self.store, self.task.name.as_str());
        let began = Instant::now();
        let (blobs, scratch) = (StoreBlobs::new(store), store.scratch());
        let run = StageRun {
            store,
            node: name,
            ctx: Ctx {
                blobs: &blobs,
                cancel,
                progress: &NodeProgress::new(name, listener),
                checkpoints: &FileCheckpoints::new(store, &key.digest, name, listener),
                memos: &StoreMemos::new(store, key.digest, name, listener),
                scratch: &scratch,
                threads: self.threads,
                began,
            },
            def: &self.task.def,
            stage: self.task.bound.as_ref(),
            key,
            inputs: &Inputs(key.action.inputs.clone()),
            listed: None,
            check: BlobCheck::Outputs,
            shared: None,
            elsewhere: None,
            metadata: &RunMetadata {
                seconds: 0.0,
                peak_mb: 0,
                started_unix_s: unix_seconds(),
                device: "cpu".to_owned(),
                program: self.program.to_owned(),
                counts: BTreeMap::new(),
                parts_s: BTreeMap::new(),
            },
            warn: &|message| {
                listener.on_event(&Event::Warning {
                    node: Some(name.to_owned()),
                    message: message.to_owned(),
                });
            },
        };
        make_part(&run, self.kind, &self.shard)
    }
}

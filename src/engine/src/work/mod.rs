//! The grains of work: what a node does when its own key is not in the store.

mod expand;
mod fold;
mod map;
mod measure;
mod source;

use std::collections::BTreeMap;

use marf_cache::{ContentHash, Digest, Record, RunMetadata, Store, StoreError};
use marf_stage::{Ctx, Inputs, Listing, Measure, NodeSpec, Outputs, Stage, StageDef, StageError, Work};

use crate::{
    bench::blob_error,
    key::{Key, PartContent},
};

pub(crate) use expand::reduce;

/// Figures of a node's work.
pub(crate) type Counts = BTreeMap<String, u64>;

/// What came of a node's work.
pub(crate) enum Produced {
    Outputs(Outputs, Counts),
    /// Nodes that must run first.
    Children(Vec<NodeSpec>),
}

/// Whether parts of earlier runs are taken on trust or looked at blob by blob.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Check {
    Names,
    Blobs,
}

/// A node at work.
#[derive(Clone, Copy)]
pub(crate) struct Job<'a> {
    pub(crate) store: &'a Store,
    pub(crate) ctx: Ctx<'a>,
    pub(crate) def: &'a StageDef,
    pub(crate) stage: &'a dyn Stage,
    pub(crate) inputs: &'a Inputs,
    pub(crate) listing: Option<&'a Listing>,
    pub(crate) check: Check,
    pub(crate) metadata: &'a RunMetadata,
}

/// Does the node's work.
pub(crate) fn perform(job: &Job<'_>) -> Result<Produced, StageError> {
    let outputs = |(outputs, counts)| Produced::Outputs(outputs, counts);
    match job.stage.work() {
        Work::Source(source) => source::perform(job, source).map(outputs),
        Work::Map(map) => map::perform(job, map).map(outputs),
        Work::Fold(fold) => fold::perform(job, fold).map(outputs),
        Work::Set(set) => Ok(outputs((set.run(&job.ctx, job.inputs)?, Counts::new()))),
        Work::Expand(expand) => Ok(Produced::Children(expand.expand(&job.ctx, job.inputs)?)),
    }
}

impl Job<'_> {
    /// Returns the key of a part of this node's work.
    fn part_key(&self, what: &'static str, params: &dyn ContentHash, of: &dyn ContentHash) -> Key {
        let content = PartContent {
            what,
            stage: self.def.name,
            version: self.def.version,
            params,
            of,
        };
        content.key()
    }

    /// Returns the key of the table of measures of one shard, which several stages may share.
    fn table_key(&self, measure: &dyn Measure, shard: u32) -> Digest {
        let (stage, version) = measure.shared().unwrap_or((self.def.name, self.def.version));
        let content = PartContent {
            what: "measure",
            stage,
            version,
            params: measure.measure_params(),
            of: &shard,
        };
        content.key().digest
    }

    fn part_hit(&self, key: &Key) -> Result<Option<Record>, StageError> {
        self.store.hit(&key.digest).map_err(store_error)
    }

    /// Stages the record of a part.
    fn put_part(&self, key: Key, outputs: Outputs) -> Result<(), StageError> {
        let outputs = sized(self.store, outputs)?;
        self.store.put_record(Record {
            key: key.digest,
            stage: self.def.name.to_owned(),
            version: self.def.version,
            manifest: key.manifest,
            outputs,
            children: BTreeMap::new(),
            metadata: self.metadata.clone(),
        });
        Ok(())
    }
}

pub(crate) fn store_error(error: StoreError) -> StageError {
    StageError::Blob(blob_error(error))
}

/// Adds their lengths to outputs; each must be in the store.
pub(crate) fn sized(
    store: &Store,
    outputs: Outputs,
) -> Result<BTreeMap<String, marf_cache::Output>, StageError> {
    let sized = outputs
        .into_iter()
        .map(|(name, digest)| match store.size_of(&digest) {
            Some(bytes) => Ok((name, marf_cache::Output { digest, bytes })),
            None => Err(crate::photos::bug(format!(
                "output `{name}` names a blob that is not in the store"
            ))),
        });
    sized.collect()
}

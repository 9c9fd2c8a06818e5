//! One run of a stage, and the records of its parts.

use std::collections::BTreeMap;

use marf_cache::{ContentHash, Digest, Output, Record, RunMetadata, Store};
use marf_stage::{Ctx, Inputs, Listing, Measure, Outputs, Stage, StageDef, StageError};

use crate::{
    errors::{contract_violation, store_error},
    key::{Key, PartContent},
};

/// Figures of the work of a node, by name.
pub(crate) type Counts = BTreeMap<String, u64>;

/// How thoroughly stored parts are checked before they are reused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum BlobCheck {
    /// Their leaves are in the store.
    Names,
    /// Every blob that a row names is in the store.
    Blobs,
}

/// One run of a stage: its context, its inputs, and the store for its parts.
#[derive(Clone, Copy)]
pub(crate) struct StageRun<'a> {
    pub(crate) store: &'a Store,
    pub(crate) ctx: Ctx<'a>,
    pub(crate) def: &'a StageDef,
    pub(crate) stage: &'a dyn Stage,
    pub(crate) inputs: &'a Inputs,
    pub(crate) listing: Option<&'a Listing>,
    pub(crate) check: BlobCheck,
    pub(crate) metadata: &'a RunMetadata,
}

impl StageRun<'_> {
    /// Returns the key of a part of this node's work.
    pub(super) fn part_key(&self, what: &'static str, params: &dyn ContentHash, of: &dyn ContentHash) -> Key {
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
    pub(super) fn table_key(&self, measure: &dyn Measure, shard: u32) -> Digest {
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

    /// Returns the stored record of a part.
    pub(super) fn part_hit(&self, key: &Key) -> Result<Option<Record>, StageError> {
        self.store.hit(&key.digest).map_err(store_error)
    }

    /// Stores the record of a part with the next commit.
    pub(super) fn put_part(&self, key: Key, outputs: Outputs) -> Result<(), StageError> {
        let outputs = with_lengths(self.store, outputs)?;
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

/// Adds their lengths to outputs; each must be in the store.
pub(crate) fn with_lengths(store: &Store, outputs: Outputs) -> Result<BTreeMap<String, Output>, StageError> {
    let with_lengths = outputs
        .into_iter()
        .map(|(name, digest)| match store.size_of(&digest) {
            Some(bytes) => Ok((name, Output { digest, bytes })),
            None => Err(contract_violation(format!(
                "output `{name}` names a blob that is not in the store"
            ))),
        });
    with_lengths.collect()
}

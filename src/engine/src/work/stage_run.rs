//! One run of a stage, and the records of its parts.

use std::collections::BTreeMap;

use marf_cache::{
    ACTION_FORMAT, Action, Digest, Output, Record, RunMetadata, Store, digest_list,
    manifest::{LeafRef, Root},
    read_digest_list,
};
use marf_stage::{Ctx, Inputs, Outputs, PHOTOS, Stage, StageDef, StageError, VERDICTS};
use serde_json::json;

use crate::{
    errors::{contract_violation, store_error},
    items::{read_refs, rows_of, write_refs, write_set},
    key::Key,
    listing::SourceListing,
    shared::{SharedResults, fetch_lacking},
    stage_io::StoreBlobs,
};

/// Figures of the work of a node, by name.
pub(crate) type Counts = BTreeMap<String, u64>;

/// Name of the output of a step of a fold with its addition to the state.
pub(super) const ADDED: &str = "added";

/// How thoroughly stored parts are checked before they are reused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum BlobCheck {
    /// Their outputs are in the store.
    Outputs,
    /// Every blob that they need is in the store.
    Needs,
}

/// One run of a stage: its context, its inputs, and the store for its parts.
#[derive(Clone, Copy)]
pub(crate) struct StageRun<'a> {
    pub(crate) store: &'a Store,
    pub(crate) ctx: Ctx<'a>,
    pub(crate) def: &'a StageDef,
    pub(crate) stage: &'a dyn Stage,
    /// The key of the node.
    pub(crate) key: &'a Key,
    pub(crate) inputs: &'a Inputs,
    pub(crate) listed: Option<&'a SourceListing>,
    pub(crate) check: BlobCheck,
    /// Where results are shared with other machines.
    pub(crate) shared: Option<&'a dyn SharedResults>,
    pub(crate) metadata: &'a RunMetadata,
    /// Warns the user.
    pub(crate) warn: &'a (dyn Fn(&str) + Sync),
}

/// The kinds of parts of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PartKind {
    /// A shard of a source.
    Fetch,
    /// The summary of a shard for a pass of this name.
    Summarise(&'static str),
    /// The decision on a shard.
    Decide,
    /// A step of a fold.
    Fold,
}

/// Parameter of a summary: the name of its pass.
const PASS: &str = "pass";

impl PartKind {
    /// Returns the name that the kind has in actions.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Fetch => "fetch",
            Self::Summarise(_) => "summarise",
            Self::Decide => "decide",
            Self::Fold => "fold",
        }
    }
}

/// Returns the key of the part of a node that is about one shard. No parameter is in that of a summary.
pub(crate) fn part_key(node: &Action, part: PartKind, shard: u32, inputs: BTreeMap<String, Digest>) -> Key {
    let params = match part {
        PartKind::Summarise(pass) => json!({ PASS: pass }),
        _ => node.params.clone(),
    };
    Key::new(Action {
        action: ACTION_FORMAT,
        stage: node.stage.clone(),
        version: node.version,
        part: Some(part.name().to_owned()),
        shard: Some(shard),
        params,
        inputs,
        backend: None,
        children: BTreeMap::new(),
    })
}

/// The results of a part of a node for one shard.
#[derive(Debug, Clone, Default)]
pub(super) struct Part {
    /// Leaves of the rows that are kept.
    pub(super) photos: Vec<LeafRef>,
    /// Leaves of the verdicts.
    pub(super) verdicts: Vec<LeafRef>,
    /// The addition of a fold to its state.
    pub(super) added: Option<Digest>,
}

/// The results of a node of many parts.
pub(crate) struct PartedOutputs {
    pub(crate) outputs: Outputs,
    pub(crate) counts: Counts,
    /// Keys of the parts, in the order of the shards.
    pub(crate) parts: Vec<(u32, Digest)>,
}

impl StageRun<'_> {
    /// Returns the key of the part of this node's work that is about one shard.
    pub(super) fn part_key(&self, part: PartKind, shard: u32, inputs: BTreeMap<String, Digest>) -> Key {
        part_key(&self.key.action, part, shard, inputs)
    }

    /// Fetches the results of parts that another machine has made and the store lacks.
    pub(super) fn fetch_parts(&self, keys: impl Iterator<Item = Digest>) -> Result<(), StageError> {
        match self.check {
            BlobCheck::Outputs => fetch_lacking(self.shared, self.store, keys).map_err(store_error),
            // What was lost here is made here.
            BlobCheck::Needs => Ok(()),
        }
    }

    /// Returns the record of a part, if all is there that this run asks for.
    pub(super) fn part_record(&self, key: &Digest) -> Result<Option<Record>, StageError> {
        let record = self.store.hit(key).map_err(store_error)?;
        let is_whole = |record: &Record| self.check == BlobCheck::Outputs || has_needs(self.store, record);
        Ok(record.filter(is_whole))
    }

    /// Returns the stored result of a part, if it is whole.
    pub(super) fn part_hit(&self, key: &Digest) -> Result<Option<Part>, StageError> {
        let Some(record) = self.part_record(key)? else {
            return Ok(None);
        };
        let refs = |name: &str| match record.outputs.get(name) {
            Some(output) => read_refs(&self.ctx, &output.digest),
            None => Err(contract_violation(format!("a part lacks its output `{name}`"))),
        };
        let read = || {
            Ok(Part {
                photos: refs(PHOTOS)?,
                verdicts: refs(VERDICTS)?,
                added: record.outputs.get(ADDED).map(|output| output.digest),
            })
        };
        match read() {
            // A part that was damaged is made again.
            Err(StageError::Blob(error)) if error.lost.is_some() => Ok(None),
            part => part.map(Some),
        }
    }

    /// Returns a context whose blobs remember what is stored for one part.
    pub(super) fn with_blobs<'b>(&'b self, blobs: &'b StoreBlobs<'b>) -> Ctx<'b> {
        Ctx { blobs, ..self.ctx }
    }

    /// Stores the record of a part with the next commit. `blobs` are those that the part read and stored.
    pub(super) fn put_part(&self, key: &Key, part: &Part, blobs: &StoreBlobs<'_>) -> Result<(), StageError> {
        self.put_source_part(key, part, blobs, None)
    }

    /// As [`StageRun::put_part`], for a part that was read from an archive. `origins` lists where the files came from.
    pub(super) fn put_source_part(
        &self,
        key: &Key,
        part: &Part,
        blobs: &StoreBlobs<'_>,
        origins: Option<Digest>,
    ) -> Result<(), StageError> {
        let ctx = self.with_blobs(blobs);
        let mut outputs = Outputs::from([
            (PHOTOS.to_owned(), write_refs(&ctx, &part.photos)?),
            (VERDICTS.to_owned(), write_refs(&ctx, &part.verdicts)?),
        ]);
        outputs.extend(part.added.map(|added| (ADDED.to_owned(), added)));
        self.put_outputs(key, outputs, blobs.take_stored(), origins)
    }

    /// Stores the record of a part with the next commit. `stored` are the blobs that it needs, including its outputs. `origins` lists where
    /// the files that it read came from.
    pub(super) fn put_outputs(
        &self,
        key: &Key,
        outputs: Outputs,
        stored: Vec<Digest>,
        origins: Option<Digest>,
    ) -> Result<(), StageError> {
        put_action(self.store, key)?;
        self.store.put_record(Record {
            key: key.digest,
            stage: self.def.name.to_owned(),
            needs: put_needs(self.store, stored, &outputs)?,
            outputs: with_lengths(self.store, outputs)?,
            parts: None,
            children: BTreeMap::new(),
            origins,
            metadata: self.metadata.clone(),
        });
        Ok(())
    }

    /// Stores the outputs of a node from those of its shards, and adds their figures to `counts`.
    pub(super) fn join(
        &self,
        parts: Vec<(u32, Digest)>,
        whole: Part,
        mut counts: Counts,
    ) -> Result<PartedOutputs, StageError> {
        let kept = rows_of(&whole.photos);
        let rejected = rows_of(&whole.verdicts).saturating_sub(kept);
        counts.extend([("photos".to_owned(), kept), ("rejected".to_owned(), rejected)]);
        let outputs = Outputs::from([
            (PHOTOS.to_owned(), write_set(&self.ctx, whole.photos)?),
            (VERDICTS.to_owned(), write_set(&self.ctx, whole.verdicts)?),
        ]);
        Ok(PartedOutputs {
            outputs,
            counts,
            parts,
        })
    }
}

/// Joins parts in their order.
impl FromIterator<Part> for Part {
    fn from_iter<I: IntoIterator<Item = Part>>(parts: I) -> Self {
        let mut whole = Self::default();
        for part in parts {
            whole.photos.extend(part.photos);
            whole.verdicts.extend(part.verdicts);
        }
        whole
    }
}

/// Stores the bytes of an action, so that its key can be computed again from them.
pub(crate) fn put_action(store: &Store, key: &Key) -> Result<(), StageError> {
    let digest = store.put(&key.action.encode()).map_err(store_error)?;
    debug_assert_eq!(digest, key.digest);
    Ok(())
}

/// Stores the keys of the parts of a node, by shard, as a set.
pub(crate) fn put_parts(store: &Store, parts: &[(u32, Digest)]) -> Result<Digest, StageError> {
    let leaves = parts.iter().map(|(shard, key)| LeafRef {
        shard: *shard,
        leaf: *key,
        rows: 0,
    });
    let parts = Root {
        leaves: leaves.collect(),
    };
    parts.write(|bytes| store.put(bytes)).map_err(store_error)
}

/// Stores the list of the blobs that a record needs in addition to its outputs. None without such blobs.
pub(crate) fn put_needs(
    store: &Store,
    mut stored: Vec<Digest>,
    outputs: &Outputs,
) -> Result<Option<Digest>, StageError> {
    stored.retain(|digest| !outputs.values().any(|output| output == digest));
    if stored.is_empty() {
        Ok(None)
    } else {
        store.put(&digest_list(&stored)).map(Some).map_err(store_error)
    }
}

/// Returns the blobs that a record needs in addition to its outputs. None if their list is lost.
pub(crate) fn needs_of(store: &Store, record: &Record) -> Option<Vec<Digest>> {
    match &record.needs {
        None => Some(Vec::new()),
        Some(list) => read_digest_list(&store.get(list).ok()?),
    }
}

/// Returns whether everything that a record needs is in the store.
fn has_needs(store: &Store, record: &Record) -> bool {
    needs_of(store, record).is_some_and(|needs| needs.iter().all(|digest| store.contains(digest)))
}

/// Adds their lengths to outputs, each of which must be in the store.
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

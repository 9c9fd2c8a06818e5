//! Listings of sources, made for every plan and every run.

use std::{
    collections::BTreeMap,
    convert::Infallible,
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    sync::Arc,
    time::Instant,
};

use marf_cache::{
    Action, Digest, LISTING, Store, canonical_json,
    manifest::{LeafRef, Root},
};
use marf_stage::{
    COMPANIONS, Cancel, Checkpoints, Ctx, Files, Inputs, Listing, Memos, Progress, Stage, StageError, Work,
};

use parking_lot::Mutex;

use crate::{
    errors::{contract_violation, panicked},
    key::{Change, changes_between, file_path, shard_path},
    stage_io::{StoreBlobs, load_memo},
};

/// A listing, and the inputs that represent it in the key of its source.
#[derive(Clone)]
pub(crate) struct SourceListing {
    pub(crate) listing: Listing,
    pub(crate) inputs: Inputs,
}

/// The listings of sources, by the names of their nodes. Graphs of one pipeline that share this ask each source once, however often they
/// are planned and run. The next program sees an archive that changes meanwhile.
#[derive(Clone, Default)]
pub struct Listings(Arc<Mutex<BTreeMap<String, SourceListing>>>);

impl Listings {
    /// Returns the known listing of a node, or else asks its source.
    pub(crate) fn get_or_ask(
        &self,
        node: &str,
        ask: impl FnOnce() -> Result<Option<SourceListing>, StageError>,
    ) -> Result<Option<SourceListing>, StageError> {
        if let Some(known) = self.0.lock().get(node) {
            return Ok(Some(known.clone()));
        }
        let listed = ask()?;
        if let Some(listed) = &listed {
            self.keep(node, listed);
        }
        Ok(listed)
    }

    /// Stores the present listing of a node: some archives show their contents only in a fetch.
    pub(crate) fn keep(&self, node: &str, listed: &SourceListing) {
        self.0.lock().insert(node.to_owned(), listed.clone());
    }
}

/// What a source needs to answer questions about its archive.
pub(crate) struct Inquiry<'a> {
    /// The store, which the source may read.
    pub(crate) store: &'a Store,
    pub(crate) cancel: &'a Cancel,
    pub(crate) progress: &'a dyn Progress,
    /// The threads that the source works on.
    pub(crate) pool: &'a rayon::ThreadPool,
}

impl Inquiry<'_> {
    /// Lists what a source offers. None for other stages.
    pub(crate) fn list(&self, stage: &dyn Stage) -> Result<Option<SourceListing>, StageError> {
        let Work::Source(source) = stage.work() else {
            return Ok(None);
        };
        let listing = self.ask(|ctx| source.list(ctx))?;
        let unsorted = listing
            .shards
            .windows(2)
            .find(|pair| pair[0].shard >= pair[1].shard);
        if let Some(pair) = unsorted {
            let shard = pair[1].shard;
            return Err(contract_violation(format!(
                "shard {shard} is listed twice or out of order"
            )));
        }
        Ok(Some(SourceListing::new(listing)))
    }

    fn ask<T: Send>(
        &self,
        question: impl Fn(&Ctx<'_>) -> Result<T, StageError> + Sync,
    ) -> Result<T, StageError> {
        let scratch: PathBuf = self.store.scratch();
        let blobs = StoreBlobs::new(self.store);
        let (store, cancel, progress) = (self.store, self.cancel, self.progress);
        let threads = self.pool.current_num_threads();
        self.pool.install(|| {
            let ctx = Ctx {
                blobs: &blobs,
                cancel,
                progress,
                checkpoints: &ReadOnly(store),
                memos: &ReadOnly(store),
                scratch: &scratch,
                threads,
                began: Instant::now(),
            };
            catch_unwind(AssertUnwindSafe(|| question(&ctx)))
                .unwrap_or_else(|payload| Err(panicked(payload.as_ref())))
        })
    }

    /// Returns every file that differs between a listing and that of an earlier action. Only shards whose files both know are compared.
    pub(crate) fn file_changes(
        &self,
        stage: &dyn Stage,
        listed: &SourceListing,
        earlier: &Action,
    ) -> Result<Vec<Change>, StageError> {
        let Work::Source(source) = stage.work() else {
            return Ok(Vec::new());
        };
        let store = self.store;
        let (mut old, mut new) = (BTreeMap::new(), BTreeMap::new());
        for change in listed.changes_since(store, earlier).unwrap_or_default() {
            let Some(shard) = change.shard() else { continue };
            let now = self.ask(|ctx| match change.new {
                Some(_) => source.files(ctx, shard),
                None => Ok(Some(Files::default())),
            })?;
            let digest = change.old.as_ref().and_then(|digest| digest.parse().ok());
            let before = match digest {
                Some(digest) => store.get(&digest).ok().and_then(|bytes| Files::decode(&bytes)),
                None => Some(Files::default()),
            };
            if let (Some(before), Some(now)) = (before, now) {
                for (files, paths) in [(before, &mut old), (now, &mut new)] {
                    let files = files.0.into_iter();
                    paths.extend(files.map(|(name, digest)| (file_path(shard, &name), digest.to_string())));
                }
            }
        }
        Ok(changes_between(&old, &new))
    }
}

/// Returns the inputs that represent a listing. `put` stores their bytes, or only computes digests.
fn inputs<E>(listing: &Listing, mut put: impl FnMut(&[u8]) -> Result<Digest, E>) -> Result<Inputs, E> {
    let leaves = listing.shards.iter().map(|shard| LeafRef {
        shard: shard.shard,
        leaf: shard.fingerprint,
        rows: 0,
    });
    let shards = Root {
        leaves: leaves.collect(),
    };
    let mut inputs = BTreeMap::from([(LISTING.to_owned(), shards.write(&mut put)?)]);
    if !listing.companions.is_empty() {
        inputs.insert(COMPANIONS.to_owned(), put(&companions(listing))?);
    }
    Ok(Inputs(inputs))
}

/// Returns the bytes of the output [`COMPANIONS`]: digests by name, as JSON.
pub(crate) fn companions(listing: &Listing) -> Vec<u8> {
    // Names and digests always serialise.
    canonical_json(&serde_json::to_value(&listing.companions).unwrap_or_default())
}

impl SourceListing {
    /// Returns a listing with the inputs that represent it. Stores nothing.
    pub(crate) fn new(listing: Listing) -> Self {
        let Ok(inputs) = inputs(&listing, |bytes| Ok::<_, Infallible>(Digest::from_content(bytes)));
        Self { listing, inputs }
    }

    /// Stores the blobs of the inputs, so that a later run can find out which shards changed.
    pub(crate) fn store(&self, ctx: &Ctx<'_>) -> Result<(), StageError> {
        inputs(&self.listing, |bytes| ctx.put(bytes)).map(drop)
    }

    /// Returns the shards that differ from those of an earlier action. None if its listing is lost.
    pub(crate) fn changes_since(&self, store: &Store, earlier: &Action) -> Option<Vec<Change>> {
        let root = earlier.inputs.get(LISTING)?;
        let listed = store.set(root).ok()?;
        let old = fingerprints(listed.leaves.iter().map(|leaf| (leaf.shard, leaf.leaf)));
        let shards = self.listing.shards.iter();
        let new = fingerprints(shards.map(|shard| (shard.shard, shard.fingerprint)));
        Some(changes_between(&old, &new))
    }
}

fn fingerprints(shards: impl Iterator<Item = (u32, Digest)>) -> BTreeMap<String, String> {
    shards
        .map(|(shard, fingerprint)| (shard_path(shard), fingerprint.to_string()))
        .collect()
}

/// Checkpoints and memos of a listing: memos are read, nothing is stored.
struct ReadOnly<'a>(&'a Store);

impl Checkpoints for ReadOnly<'_> {
    fn load(&self, _part: &str) -> Option<Vec<u8>> {
        None
    }

    fn save(&self, _part: &str, _state: &[u8]) {}
}

impl Memos for ReadOnly<'_> {
    fn load(&self, key: &Digest) -> Option<Arc<[u8]>> {
        load_memo(self.0, key)
    }

    fn save(&self, _key: &Digest, _table: &[u8]) {}
}

/// Ignores progress: of a listing that is made for a plan.
pub(crate) struct NoProgress;

impl Progress for NoProgress {
    fn at(&self, _done: u64, _total: u64, _note: &str) {}
}

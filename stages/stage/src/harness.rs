//! Runs a stage without an engine: a store in memory, for tests of stages.

use std::collections::{BTreeMap, BTreeSet};
use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use marf_cache::{
    Digest,
    file::{Links, read_within},
    manifest::{Leaf, LeafRef, Root, Row},
};
use parking_lot::Mutex;

use crate::{
    BlobError, Blobs, Cancel, Checkpoints, Ctx, Keep, Map, Measured, Memos, Progress, StageError, Verdict,
};

/// Returns the verdicts on the items of each shard, in the same order, after all passes of the comparison.
///
/// # Errors
/// The first of the stage.
pub fn decide(map: &dyn Map, shards: &[Vec<Measured<'_>>]) -> Result<Vec<Vec<Verdict>>, StageError> {
    let mut context = Vec::new();
    if let Some(comparison) = map.comparison() {
        for pass in 0..comparison.passes().len() {
            let summarise = |items: &Vec<Measured<'_>>| comparison.summarise(pass, &context, items);
            let mut summaries = shards.iter().map(|items| summarise(items).map(Arc::from));
            context = comparison.context(pass, &context, &mut summaries)?;
        }
    }
    shards.iter().map(|items| map.decide(&context, items)).collect()
}

/// A store in memory. Progress is ignored.
#[derive(Default)]
pub struct Harness {
    blobs: Mutex<BTreeMap<Digest, Arc<[u8]>>>,
    reads: Mutex<BTreeMap<Digest, u64>>,
    commits: Mutex<u64>,
    checkpoints: Mutex<BTreeMap<String, Vec<u8>>>,
    memos: Mutex<BTreeMap<Digest, Arc<[u8]>>>,
    /// Whether stages under test should stop.
    pub cancel: Cancel,
    /// Folder for files of unfinished work. A test that needs a folder sets it.
    pub scratch: PathBuf,
}

/// A store with the same contents, of its own from then on.
impl Clone for Harness {
    fn clone(&self) -> Self {
        Self {
            blobs: Mutex::new(self.blobs.lock().clone()),
            reads: Mutex::new(self.reads.lock().clone()),
            commits: Mutex::new(*self.commits.lock()),
            checkpoints: Mutex::new(self.checkpoints.lock().clone()),
            memos: Mutex::new(self.memos.lock().clone()),
            cancel: self.cancel.clone(),
            scratch: self.scratch.clone(),
        }
    }
}

impl Harness {
    /// Returns the context of a stage under test.
    pub fn ctx(&self) -> Ctx<'_> {
        Ctx {
            blobs: self,
            cancel: &self.cancel,
            progress: self,
            checkpoints: self,
            memos: self,
            scratch: &self.scratch,
            threads: 1,
            began: Instant::now(),
        }
    }

    /// Stores bytes.
    pub fn put(&self, bytes: &[u8]) -> Digest {
        let digest = Digest::from_content(bytes);
        self.blobs.lock().insert(digest, Arc::from(bytes));
        digest
    }

    /// Reads bytes that a stage stored.
    pub fn get(&self, digest: &Digest) -> Option<Arc<[u8]>> {
        self.blobs.lock().get(digest).cloned()
    }

    /// Returns how often stages have read a blob.
    pub fn reads(&self, digest: &Digest) -> u64 {
        self.reads.lock().get(digest).copied().unwrap_or(0)
    }

    /// Returns how often stages have asked for what they stored to be made durable.
    pub fn commits(&self) -> u64 {
        *self.commits.lock()
    }

    /// Removes a blob, as a damaged store may.
    pub fn forget(&self, digest: &Digest) {
        self.blobs.lock().remove(digest);
    }

    /// Stores items `(shard, row)` as a set and returns the digest of its root.
    ///
    /// # Panics
    /// If two rows of one shard share an id.
    #[allow(
        clippy::unwrap_used,
        reason = "a test fixture that is wrong should stop the test"
    )]
    pub fn put_set(&self, items: &[(u32, Row)]) -> Digest {
        let shards: BTreeSet<u32> = items.iter().map(|(shard, _)| *shard).collect();
        let leaves = shards.into_iter().map(|shard| {
            let rows: Vec<Row> = items
                .iter()
                .filter(|item| item.0 == shard)
                .map(|item| item.1.clone())
                .collect();
            let count = rows.len() as u32;
            LeafRef {
                shard,
                leaf: self.put(&Leaf::new(rows).unwrap().encode()),
                rows: count,
            }
        });
        let root = Root {
            leaves: leaves.collect(),
        };
        let Ok(digest) = root.write(|bytes| Ok::<_, Infallible>(self.put(bytes)));
        digest
    }
}

impl Blobs for Harness {
    fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, BlobError> {
        *self.reads.lock().entry(*digest).or_default() += 1;
        Self::get(self, digest).ok_or_else(|| BlobError {
            message: format!("no blob {digest}"),
            lost: Some(*digest),
        })
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError> {
        Ok(Self::put(self, bytes))
    }

    fn put_file(&self, path: &Path, max_bytes: u64, _keep: Keep) -> Result<(Digest, Arc<[u8]>), BlobError> {
        let refused = |why: String| BlobError {
            message: format!("cannot read `{}`: {why}", path.display()),
            lost: None,
        };
        let bytes =
            read_within(path, max_bytes, Links::Followed).map_err(|error| refused(error.to_string()))?;
        Ok((Self::put(self, &bytes), Arc::from(bytes)))
    }

    fn contains(&self, digest: &Digest) -> bool {
        self.blobs.lock().contains_key(digest)
    }

    fn commit(&self) -> Result<(), BlobError> {
        *self.commits.lock() += 1;
        Ok(())
    }
}

impl Progress for Harness {
    fn at(&self, _done: u64, _total: u64, _note: &str) {}
}

impl Checkpoints for Harness {
    fn load(&self, part: &str) -> Option<Vec<u8>> {
        self.checkpoints.lock().get(part).cloned()
    }

    fn save(&self, part: &str, state: &[u8]) {
        self.checkpoints.lock().insert(part.to_owned(), state.to_vec());
    }
}

impl Memos for Harness {
    fn load(&self, key: &Digest) -> Option<Arc<[u8]>> {
        self.memos.lock().get(key).cloned()
    }

    fn save(&self, key: &Digest, table: &[u8]) {
        self.memos.lock().insert(*key, Arc::from(table));
    }
}

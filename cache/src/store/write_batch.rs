//! Writes that become durable together.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant},
};

use super::record::Record;
use crate::Digest;

/// A batch is committed when it is this old ...
const MAX_AGE: Duration = Duration::from_secs(1);
/// ... or holds this many bytes.
const MAX_BYTES: u64 = 64 << 20;

/// Bytes of a memo in a pack: blob and maker.
const MEMO_BYTES: usize = 64;

/// Blobs, records and memos that are committed together.
#[derive(Clone, Default)]
pub(super) struct WriteBatch {
    pub(super) small: BTreeMap<Digest, Arc<[u8]>>,
    pub(super) large: BTreeMap<Digest, LargeBlob>,
    pub(super) records: BTreeMap<Digest, Record>,
    pub(super) memos: BTreeMap<Digest, Memo>,
    bytes: u64,
    first_write: Option<Instant>,
}

/// A blob under a key of a stage's own making.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Memo {
    pub(super) blob: Digest,
    /// Key of the action that made it. The memo lives as long as the result of that action.
    pub(super) maker: Digest,
}

/// A blob in a temporary file.
#[derive(Clone)]
pub(super) struct LargeBlob {
    pub(super) path: PathBuf,
    pub(super) bytes: u64,
}

impl Memo {
    /// Returns the bytes kept in a pack.
    pub(super) fn encode(&self) -> [u8; MEMO_BYTES] {
        let mut bytes = [0; MEMO_BYTES];
        let (blob, maker) = bytes.split_at_mut(MEMO_BYTES / 2);
        blob.copy_from_slice(self.blob.as_bytes());
        maker.copy_from_slice(self.maker.as_bytes());
        bytes
    }

    /// Reads what [`Memo::encode`] wrote.
    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        let (blob, maker) = bytes.split_at_checked(MEMO_BYTES / 2)?;
        Some(Self {
            blob: Digest::from_bytes(blob.try_into().ok()?),
            maker: Digest::from_bytes(maker.try_into().ok()?),
        })
    }
}

impl WriteBatch {
    /// Adds a blob that will go into a pack.
    pub(super) fn add_small(&mut self, digest: Digest, bytes: &[u8]) {
        self.note_write(bytes.len() as u64);
        self.small.insert(digest, Arc::from(bytes));
    }

    /// Adds a blob that will be a file of its own.
    pub(super) fn add_large(&mut self, digest: Digest, large: LargeBlob) {
        self.note_write(large.bytes);
        self.large.insert(digest, large);
    }

    /// Adds a record. The first of two records of one key is kept, as in the index.
    pub(super) fn add_record(&mut self, record: Record) {
        self.note_write(0);
        self.records.entry(record.key).or_insert(record);
    }

    /// Adds a memo. The last of two memos of one key is kept.
    pub(super) fn add_memo(&mut self, key: Digest, memo: Memo) {
        self.note_write(0);
        self.memos.insert(key, memo);
    }

    fn note_write(&mut self, bytes: u64) {
        self.bytes += bytes;
        self.first_write.get_or_insert_with(Instant::now);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.first_write.is_none()
    }

    /// Returns whether the batch is old or large enough to be committed.
    pub(super) fn is_due(&self) -> bool {
        self.bytes >= MAX_BYTES || self.first_write.is_some_and(|first| first.elapsed() >= MAX_AGE)
    }

    /// Returns the length of a blob of this batch, in bytes.
    pub(super) fn size_of(&self, digest: &Digest) -> Option<u64> {
        let small = self.small.get(digest).map(|bytes| bytes.len() as u64);
        small.or_else(|| self.large.get(digest).map(|large| large.bytes))
    }

    /// Restores an older batch that could not be committed. Newer memos win, older records win.
    pub(super) fn restore(&mut self, older: &Self) {
        let newer = std::mem::replace(self, older.clone());
        self.small.extend(newer.small);
        self.large.extend(newer.large);
        self.memos.extend(newer.memos);
        for (key, record) in newer.records {
            self.records.entry(key).or_insert(record);
        }
        self.bytes += newer.bytes;
    }

    /// Returns the digests of its blobs.
    pub(super) fn blobs(&self) -> impl Iterator<Item = Digest> {
        self.small.keys().chain(self.large.keys()).copied()
    }
}

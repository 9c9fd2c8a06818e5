//! What has been put and is not sealed yet.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant},
};

use super::Record;
use crate::Digest;

/// A group is sealed when it is this old ...
const AGE: Duration = Duration::from_secs(1);
/// ... or this large.
const BYTES: u64 = 64 << 20;

/// Blobs, records and memos that become durable together.
#[derive(Clone, Default)]
pub(super) struct Group {
    pub(super) small: BTreeMap<Digest, Arc<[u8]>>,
    pub(super) large: BTreeMap<Digest, Large>,
    pub(super) records: BTreeMap<Digest, Record>,
    pub(super) memos: BTreeMap<Digest, Digest>,
    bytes: u64,
    since: Option<Instant>,
}

/// A blob that lies in a temporary file.
#[derive(Clone)]
pub(super) struct Large {
    pub(super) path: PathBuf,
    pub(super) bytes: u64,
}

impl Group {
    pub(super) fn add_small(&mut self, digest: Digest, bytes: &[u8]) {
        self.began(bytes.len() as u64);
        self.small.insert(digest, Arc::from(bytes));
    }

    pub(super) fn add_large(&mut self, digest: Digest, large: Large) {
        self.began(large.bytes);
        self.large.insert(digest, large);
    }

    /// Keeps the first of two records of one key, as the index does.
    pub(super) fn add_record(&mut self, record: Record) {
        self.began(0);
        self.records.entry(record.key).or_insert(record);
    }

    pub(super) fn add_memo(&mut self, key: Digest, blob: Digest) {
        self.began(0);
        self.memos.insert(key, blob);
    }

    fn began(&mut self, bytes: u64) {
        self.bytes += bytes;
        self.since.get_or_insert_with(Instant::now);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.since.is_none()
    }

    pub(super) fn is_due(&self) -> bool {
        self.bytes >= BYTES || self.since.is_some_and(|since| since.elapsed() >= AGE)
    }

    pub(super) fn size_of(&self, digest: &Digest) -> Option<u64> {
        let small = self.small.get(digest).map(|bytes| bytes.len() as u64);
        small.or_else(|| self.large.get(digest).map(|large| large.bytes))
    }

    /// Takes back an older group that could not be sealed; what came later wins where it may.
    pub(super) fn take_back(&mut self, older: &Self) {
        let newer = std::mem::replace(self, older.clone());
        self.small.extend(newer.small);
        self.large.extend(newer.large);
        self.memos.extend(newer.memos);
        for (key, record) in newer.records {
            self.records.entry(key).or_insert(record);
        }
        self.bytes += newer.bytes;
    }
}

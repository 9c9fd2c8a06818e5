//! Which results a push must send.

use std::collections::{BTreeMap, BTreeSet};

use futures_util::{StreamExt, TryStreamExt, stream};
use marf_cache::{Conflict, Digest, Record, Store};

use crate::{
    bucket::Bucket,
    conflict,
    error::RemoteError,
    names,
    sealed::{self, RemoteRecord, SealedValue},
};

/// Records that are asked for at once.
pub(crate) const IN_FLIGHT: usize = 64;

/// What of the results of some keys a shared store lacks.
#[derive(Default)]
pub(crate) struct Survey {
    pub(crate) new: BTreeMap<Digest, RemoteRecord>,
    /// Results that are there.
    pub(crate) known: u64,
    pub(crate) conflicts: Vec<Conflict>,
}

impl Survey {
    /// Asks for the records of keys, and for those of parts and children of what is not there.
    pub(crate) async fn take(bucket: &Bucket, store: &Store, keys: &[Digest]) -> Result<Self, RemoteError> {
        let mut survey = Self::default();
        let mut seen: BTreeSet<Digest> = BTreeSet::new();
        let mut level: BTreeSet<Digest> = keys.iter().copied().collect();
        while !level.is_empty() {
            let found = records(bucket, level.iter().copied()).await?;
            seen.append(&mut level);
            for (key, there) in found {
                let own = store.record(&key)?.ok_or(RemoteError::NotInStore { key })?;
                let may_stay = |there: &SealedValue<RemoteRecord>| !there.should_be_signed(&bucket.trust);
                match there.filter(may_stay) {
                    Some(there) => survey.note_known(there.value.record, own),
                    None => {
                        let belongings = store.belongings(&own)?;
                        level.extend(belongings.keys.iter().filter(|key| !seen.contains(key)));
                        let (blobs, keys) = (belongings.blobs, belongings.keys);
                        survey.new.insert(
                            key,
                            RemoteRecord {
                                record: own,
                                blobs,
                                keys,
                            },
                        );
                    }
                }
            }
        }
        Ok(survey)
    }

    fn note_known(&mut self, kept: Record, refused: Record) {
        self.known += 1;
        self.conflicts.extend(conflict::between(kept, refused));
    }

    /// Returns the new results in groups: parts and children are in an earlier group than what consists of them.
    pub(crate) fn in_order(&self) -> Vec<Vec<&RemoteRecord>> {
        let mut ranks = BTreeMap::new();
        let mut groups: Vec<Vec<&RemoteRecord>> = Vec::new();
        for (key, record) in &self.new {
            let rank = self.rank(key, &mut ranks);
            groups.resize_with(groups.len().max(rank + 1), Vec::new);
            if let Some(group) = groups.get_mut(rank) {
                group.push(record);
            }
        }
        groups
    }

    /// Returns the number of levels of new results below a key. A key is a digest of what it depends on, so there is no
    /// cycle.
    fn rank(&self, key: &Digest, ranks: &mut BTreeMap<Digest, usize>) -> usize {
        if let Some(rank) = ranks.get(key) {
            return *rank;
        }
        let below = self.new.get(key).into_iter().flat_map(|record| &record.keys);
        let below = below.filter(|key| self.new.contains_key(key));
        let rank = below.map(|key| self.rank(key, ranks) + 1).max().unwrap_or(0);
        ranks.insert(*key, rank);
        rank
    }
}

/// Reads the records of keys, `None` for keys without a record.
pub(crate) async fn records(
    bucket: &Bucket,
    keys: impl Iterator<Item = Digest>,
) -> Result<Vec<(Digest, Option<SealedValue<RemoteRecord>>)>, RemoteError> {
    stream::iter(keys)
        .map(|key| async move { Ok((key, record(bucket, &key).await?)) })
        .buffer_unordered(IN_FLIGHT)
        .try_collect()
        .await
}

/// Reads the record of a key, or returns `None` if it does not exist.
pub(crate) async fn record(
    bucket: &Bucket,
    key: &Digest,
) -> Result<Option<SealedValue<RemoteRecord>>, RemoteError> {
    let name = names::record(key);
    let Some(bytes) = bucket.get(&name).await? else {
        return Ok(None);
    };
    let found: SealedValue<RemoteRecord> = sealed::open(&bytes, &bucket.trust)
        .ok_or_else(|| bucket.damaged(&name, "its checksum is another"))?;
    if found.value.record.key == *key {
        Ok(Some(found))
    } else {
        Err(bucket.damaged(&name, "it is the result of another key"))
    }
}

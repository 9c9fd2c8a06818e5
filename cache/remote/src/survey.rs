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

    /// Returns the new results in groups: parts and children are in an earlier group than what consists of them. A key does
    /// not depend on children, so records of another program may name each other in a cycle. They form the last group.
    pub(crate) fn in_order(&self) -> Vec<Vec<&RemoteRecord>> {
        let mut groups: Vec<Vec<&RemoteRecord>> = Vec::new();
        let mut left: BTreeMap<&Digest, &RemoteRecord> = self.new.iter().collect();
        while !left.is_empty() {
            let waits = |record: &RemoteRecord| record.keys.iter().any(|key| left.contains_key(key));
            let (waiting, ready): (BTreeMap<_, _>, BTreeMap<_, _>) = left
                .iter()
                .map(|(key, record)| (*key, *record))
                .partition(|(_, record)| waits(record));
            if ready.is_empty() {
                groups.push(waiting.into_values().collect());
                break;
            }
            groups.push(ready.into_values().collect());
            left = waiting;
        }
        groups
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

#[cfg(test)]
mod tests {
    use marf_cache::RunMetadata;

    use super::*;

    fn key(name: &str) -> Digest {
        Digest::from_content(name.as_bytes())
    }

    /// Returns the groups of results that each name some others, by the names of their stages.
    fn groups(named: &[(&str, &[&str])]) -> Vec<BTreeSet<String>> {
        let mut survey = Survey::default();
        for (name, below) in named {
            let record = Record {
                key: key(name),
                stage: (*name).to_owned(),
                outputs: BTreeMap::new(),
                needs: None,
                parts: None,
                children: BTreeMap::new(),
                origins: None,
                metadata: RunMetadata::default(),
            };
            let record = RemoteRecord {
                record,
                blobs: Vec::new(),
                keys: below.iter().map(|name| key(name)).collect(),
            };
            survey.new.insert(key(name), record);
        }
        let names = |group: &Vec<&RemoteRecord>| group.iter().map(|one| one.record.stage.clone()).collect();
        survey.in_order().iter().map(names).collect()
    }

    #[test]
    fn what_a_result_consists_of_goes_first_and_a_cycle_goes_last() {
        let chain: &[(&str, &[&str])] = &[
            ("train", &[]),
            ("trial", &["train"]),
            ("tune", &["trial", "train", "known"]),
        ];
        assert_eq!(
            groups(chain),
            ["train", "trial", "tune"].map(|name| BTreeSet::from([name.to_owned()]))
        );
        let cycle: &[(&str, &[&str])] = &[
            ("itself", &["itself"]),
            ("one", &["other", "leaf"]),
            ("other", &["one"]),
            ("above", &["one"]),
            ("leaf", &[]),
        ];
        let last = ["above", "itself", "one", "other"].map(str::to_owned);
        assert_eq!(
            groups(cycle),
            [BTreeSet::from(["leaf".to_owned()]), BTreeSet::from(last)]
        );
    }
}

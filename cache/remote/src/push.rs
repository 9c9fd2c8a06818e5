//! A push: blobs, packs, records, the run.

use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use marf_cache::{Conflict, Digest, Store, StoreError};

use crate::{
    bucket::Bucket,
    catalogue, conflict,
    error::RemoteError,
    names,
    observer::{Meter, Observer},
    pack::{LARGE_BYTES, PACK_BYTES, PackWriter},
    presence,
    sealed::{self, RemoteRecord, RemoteRun},
    survey::{self, Survey},
};

/// Large blobs that are sent at once.
const BLOBS_IN_FLIGHT: usize = 16;
/// Packs that are sent at once. Each is in memory.
const PACKS_IN_FLIGHT: usize = 2;

/// Report of a push.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PushReport {
    /// Results that were sent.
    pub records: u64,
    /// Results that were there.
    pub known_records: u64,
    /// Blobs that were sent, those in packs among them.
    pub blobs: u64,
    /// Their bytes.
    pub blob_bytes: u64,
    /// Packs that were sent.
    pub packs: u64,
    /// Keys for which the shared store already has another result. That result stays.
    pub conflicts: Vec<Conflict>,
}

/// Blobs that a shared store lacks, with their lengths.
#[derive(Default)]
struct AbsentBlobs {
    large: BTreeMap<Digest, u64>,
    small: BTreeMap<Digest, u64>,
}

/// Sends a run with everything that the shared store lacks.
pub(crate) async fn run(
    bucket: &Bucket,
    store: &Store,
    run: &RemoteRun,
    observer: &dyn Observer,
) -> Result<PushReport, RemoteError> {
    let pushed = results(bucket, store, &run.keys, &run.blobs, observer).await?;
    let root = Digest::from_content(run.root.as_bytes());
    let name = names::run(&run.pipeline, run.started_unix_s, &root);
    bucket.put(&name, sealed::seal(run, &bucket.trust)).await?;
    Ok(pushed)
}

/// Sends the results of keys with everything that they consist of, and the given blobs, if the shared store
/// lacks them.
pub(crate) async fn results(
    bucket: &Bucket,
    store: &Store,
    keys: &[Digest],
    blobs: &[Digest],
    observer: &dyn Observer,
) -> Result<PushReport, RemoteError> {
    store.commit()?;
    let survey = Survey::take(bucket, store, keys).await?;
    let wanted: BTreeSet<Digest> = survey
        .new
        .values()
        .flat_map(|record| &record.blobs)
        .chain(blobs)
        .copied()
        .collect();
    let absent = AbsentBlobs::find(bucket, store, &wanted).await?;
    let meter = Meter::new(observer, absent.large.values().chain(absent.small.values()).sum());
    let packs = absent.packs();
    send_large(bucket, store, &absent.large, &meter).await?;
    send_packs(bucket, store, &packs, &meter).await?;
    let mut conflicts = survey.conflicts.clone();
    for group in survey.in_order() {
        conflicts.extend(send_records(bucket, &group).await?);
    }
    Ok(PushReport {
        records: survey.new.len() as u64,
        known_records: survey.known,
        blobs: (absent.large.len() + absent.small.len()) as u64,
        blob_bytes: meter.total_bytes,
        packs: packs.len() as u64,
        conflicts,
    })
}

impl AbsentBlobs {
    async fn find(bucket: &Bucket, store: &Store, wanted: &BTreeSet<Digest>) -> Result<Self, RemoteError> {
        let mut absent = Self::default();
        for digest in wanted {
            let bytes = store
                .size_of(digest)
                .ok_or(StoreError::Missing { digest: *digest })?;
            if bytes < LARGE_BYTES {
                absent.small.insert(*digest, bytes)
            } else {
                absent.large.insert(*digest, bytes)
            };
        }
        let packed = catalogue::in_packs(bucket, absent.small.keys()).await?;
        for entry in packed.values().flatten() {
            absent.small.remove(&entry.digest);
        }
        let there = presence::sizes(bucket, absent.large.keys().copied()).await?;
        // One that was cut is sent again.
        absent
            .large
            .retain(|digest, bytes| there.get(digest) != Some(bytes));
        Ok(absent)
    }

    /// Returns the small blobs by the pack that each will be in.
    fn packs(&self) -> Vec<Vec<Digest>> {
        let mut packs: Vec<Vec<Digest>> = Vec::new();
        let mut filled = u64::MAX;
        for (digest, bytes) in &self.small {
            if filled >= PACK_BYTES {
                packs.push(Vec::new());
                filled = 0;
            }
            filled += bytes;
            if let Some(pack) = packs.last_mut() {
                pack.push(*digest);
            }
        }
        packs
    }
}

async fn send_large(
    bucket: &Bucket,
    store: &Store,
    blobs: &BTreeMap<Digest, u64>,
    meter: &Meter<'_>,
) -> Result<(), RemoteError> {
    stream::iter(blobs)
        .map(|(digest, bytes)| async move {
            let blob = Bytes::from_owner(store.get(digest)?);
            bucket.put(&names::blob(digest), blob).await?;
            meter.add(*bytes);
            Ok(())
        })
        .buffer_unordered(BLOBS_IN_FLIGHT)
        .try_collect()
        .await
}

async fn send_packs(
    bucket: &Bucket,
    store: &Store,
    packs: &[Vec<Digest>],
    meter: &Meter<'_>,
) -> Result<(), RemoteError> {
    stream::iter(packs)
        .map(|digests| async move {
            let mut writer = PackWriter::default();
            for digest in digests {
                writer.add(*digest, &store.get(digest)?);
            }
            let pack = writer.finish();
            let bytes = pack.bytes.len() as u64;
            bucket.put_pack(pack).await?;
            meter.add(bytes);
            Ok(())
        })
        .buffer_unordered(PACKS_IN_FLIGHT)
        .try_collect()
        .await
}

/// Writes records once. Returns the conflicts with records that others have written since the survey.
async fn send_records(bucket: &Bucket, records: &[&RemoteRecord]) -> Result<Vec<Conflict>, RemoteError> {
    let conflicts: Vec<Option<Conflict>> = stream::iter(records)
        .map(|new| send_record(bucket, new))
        .buffer_unordered(survey::IN_FLIGHT)
        .try_collect()
        .await?;
    Ok(conflicts.into_iter().flatten().collect())
}

async fn send_record(bucket: &Bucket, new: &RemoteRecord) -> Result<Option<Conflict>, RemoteError> {
    let key = &new.record.key;
    let (name, sealed) = (names::record(key), sealed::seal(new, &bucket.trust));
    if bucket.put_new(&name, sealed.clone()).await? {
        return Ok(None);
    }
    let Some(there) = survey::record(bucket, key).await? else {
        return Ok(None);
    };
    let should_be_signed = there.should_be_signed(&bucket.trust);
    let conflict = conflict::between(there.value.record, new.record.clone());
    if conflict.is_none() && should_be_signed {
        // The result is the same. A different result never replaces it.
        bucket.put(&name, sealed).await?;
    }
    Ok(conflict)
}

//! A pull: fetches records, then the blobs that the local store lacks. Blobs are stored first.

use std::{collections::BTreeSet, time::Duration};

use futures_util::{StreamExt, stream};
use marf_cache::{Digest, Record, Store};

use crate::{
    bucket::Bucket,
    error::RemoteError,
    fetch::Plan,
    names,
    observer::{Meter, Observer},
    sealed::{self, RemoteRun, SealedValue},
    survey,
};

/// Name of a record in messages.
const RESULT: &str = "result";

/// Report of a pull.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PullReport {
    /// Results that were fetched.
    pub records: u64,
    /// Results that were in the local store.
    pub known_records: u64,
    /// Blobs that were fetched.
    pub blobs: u64,
    /// Their bytes.
    pub blob_bytes: u64,
}

/// Records and blobs that the local store lacks.
#[derive(Default)]
struct MissingResults {
    records: Vec<Record>,
    blobs: BTreeSet<Digest>,
    known: u64,
}

/// Reads the run of this root.
pub(crate) async fn read_run(bucket: &Bucket, root: &Digest) -> Result<RemoteRun, RemoteError> {
    let listed = bucket.list(names::RUNS).await?;
    let is_it = |name: &str| names::run_in(name).is_some_and(|(_, found)| found == *root);
    let missing = || RemoteError::Missing {
        place: bucket.place.clone(),
        what: "the run",
        digest: *root,
    };
    let found = listed.iter().find(|object| is_it(&object.name));
    let run = run_named(bucket, &found.ok_or_else(missing)?.name).await?;
    if run.is_believed {
        Ok(run.value)
    } else {
        Err(untrusted(bucket, 1, "run", root))
    }
}

/// Reads the run of this name, whoever wrote it.
pub(crate) async fn run_named(bucket: &Bucket, name: &str) -> Result<SealedValue<RemoteRun>, RemoteError> {
    let bytes = bucket.get(name).await?.unwrap_or_default();
    let root = names::run_in(name).map(|(_, root)| root);
    let run: Option<SealedValue<RemoteRun>> = sealed::open(&bytes, &bucket.trust);
    let run = run.filter(|run| Some(Digest::from_content(run.value.root.as_bytes())) == root);
    run.ok_or_else(|| bucket.damaged(name, "its checksum is another"))
}

/// Fetches what a run consists of.
pub(crate) async fn run(
    bucket: &Bucket,
    store: &Store,
    run: &RemoteRun,
    observer: &dyn Observer,
) -> Result<PullReport, RemoteError> {
    results(bucket, store, &run.keys, &run.blobs, observer).await
}

/// Fetches the results of keys with everything that belongs to them, and the given blobs. All keys must
/// exist.
pub(crate) async fn results(
    bucket: &Bucket,
    store: &Store,
    keys: &[Digest],
    blobs: &[Digest],
    observer: &dyn Observer,
) -> Result<PullReport, RemoteError> {
    let mut lacking = MissingResults::find(bucket, store, keys).await?;
    lacking.blobs.extend(blobs);
    lacking.blobs.retain(|blob| !store.contains(blob));
    let blob_bytes = match fetch(bucket, store, &lacking.blobs, observer).await {
        // It was damaged on its way, or a collection has just moved it to another pack.
        Err(RemoteError::Damaged { .. } | RemoteError::Missing { .. }) => {
            fetch(bucket, store, &lacking.blobs, observer).await?
        }
        fetched => fetched?,
    };
    let pulled = PullReport {
        records: lacking.records.len() as u64,
        known_records: lacking.known,
        blobs: lacking.blobs.len() as u64,
        blob_bytes,
    };
    // After a crash no record names a blob that has not come.
    store.commit()?;
    lacking
        .records
        .into_iter()
        .for_each(|record| store.put_record(record));
    store.commit()?;
    Ok(pulled)
}

fn untrusted(bucket: &Bucket, count: usize, what: &'static str, first: &Digest) -> RemoteError {
    RemoteError::Untrusted {
        place: bucket.place.clone(),
        count,
        what,
        first: *first,
    }
}

/// Fetches the results of those keys that are there, and returns why some of these were not ([`crate::Remote::fetch`]).
pub(crate) async fn what_is_there(
    bucket: &Bucket,
    store: &Store,
    keys: &[Digest],
    least_wait: Duration,
    observer: &dyn Observer,
) -> Result<Vec<RemoteError>, RemoteError> {
    let asked = stream::iter(keys).map(|key| survey::record(bucket, key));
    let answers: Vec<_> = asked.buffer_unordered(survey::IN_FLIGHT).collect().await;
    let (mut there, mut skipped, mut seconds) = (Vec::new(), Vec::new(), 0.0);
    let mut strange: Vec<Digest> = Vec::new();
    for answer in answers {
        match answer {
            Ok(None) => {}
            Ok(Some(found)) if !found.is_believed => strange.push(found.value.record.key),
            Ok(Some(found)) => {
                seconds += found.value.record.metadata.seconds;
                there.push(found.value.record.key);
            }
            Err(error @ RemoteError::Damaged { .. }) => skipped.push(error),
            Err(error) => return Err(error),
        }
    }
    if let Some(first) = strange.iter().min() {
        skipped.push(untrusted(bucket, strange.len(), RESULT, first));
    }
    if there.is_empty() {
        return Ok(skipped);
    }
    let wait = Duration::try_from_secs_f64(seconds)
        .unwrap_or(least_wait)
        .max(least_wait);
    let fetched = tokio::time::timeout(wait, results(bucket, store, &there, &[], observer)).await;
    match fetched {
        Ok(Ok(_)) => {}
        Ok(Err(
            error @ (RemoteError::Damaged { .. }
            | RemoteError::Missing { .. }
            | RemoteError::Untrusted { .. }),
        )) => skipped.push(error),
        Ok(Err(error)) => return Err(error),
        Err(_) => skipped.push(RemoteError::Slow {
            place: bucket.place.clone(),
            waited_s: wait.as_secs(),
        }),
    }
    Ok(skipped)
}

/// Fetches blobs that the store lacks, and returns their bytes.
async fn fetch(
    bucket: &Bucket,
    store: &Store,
    blobs: &BTreeSet<Digest>,
    observer: &dyn Observer,
) -> Result<u64, RemoteError> {
    let lacking = blobs
        .iter()
        .filter(|blob| !store.contains(blob))
        .copied()
        .collect();
    let plan = Plan::make(bucket, &lacking).await?;
    let meter = Meter::new(observer, plan.bytes());
    plan.fetch(bucket, store, &meter).await?;
    Ok(meter.total_bytes)
}

impl MissingResults {
    /// Reads the records of keys that are missing or incomplete in the local store, level by level.
    async fn find(bucket: &Bucket, store: &Store, keys: &[Digest]) -> Result<Self, RemoteError> {
        let mut lacking = Self::default();
        let mut seen: BTreeSet<Digest> = BTreeSet::new();
        let mut level: BTreeSet<Digest> = keys.iter().copied().collect();
        while !level.is_empty() {
            let mut below = BTreeSet::new();
            let mut asked = Vec::new();
            for key in &level {
                match own(store, key)? {
                    Some(keys) => {
                        lacking.known += 1;
                        below.extend(keys);
                    }
                    None => asked.push(*key),
                }
            }
            for (key, found) in survey::records(bucket, asked.into_iter()).await? {
                let found = found.ok_or_else(|| RemoteError::Missing {
                    place: bucket.place.clone(),
                    what: "the result of key",
                    digest: key,
                })?;
                if !found.is_believed {
                    return Err(untrusted(bucket, 1, RESULT, &key));
                }
                below.extend(found.value.keys);
                lacking.blobs.extend(found.value.blobs);
                lacking.records.push(found.value.record);
            }
            seen.append(&mut level);
            level = below.difference(&seen).copied().collect();
        }
        Ok(lacking)
    }
}

/// Returns the keys below a result of the local store, if it has everything that belongs to the result.
fn own(store: &Store, key: &Digest) -> Result<Option<Vec<Digest>>, RemoteError> {
    let Some(record) = store.record(key)? else {
        return Ok(None);
    };
    // A list that is lost is fetched with the others.
    let belongings = store.belongings(&record).ok();
    let whole = belongings.filter(|belongings| belongings.blobs.iter().all(|blob| store.contains(blob)));
    Ok(whole.map(|belongings| belongings.keys))
}

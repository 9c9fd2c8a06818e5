//! A check that reads every record, run and index, and checks that every object they name exists. On request
//! it reads every byte.

use std::collections::{BTreeMap, BTreeSet, HashSet};

use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use marf_cache::{Digest, ReadShare};
use serde::Serialize;

use crate::{
    bucket::{Bucket, StoredObject},
    catalogue,
    error::RemoteError,
    inventory::{Inventory, PackFiles},
    names, pull,
    sealed::RemoteRecord,
    survey,
};

/// Blobs or packs that are read at once.
const IN_FLIGHT: usize = 8;

/// Options of a check.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FsckOptions {
    /// The large blobs and the packs that are fetched and compared with their digests.
    pub read_data: ReadShare,
    /// Whether damaged objects are removed, with everything that names them. The next push sends them again.
    pub repair: bool,
}

/// An object that is not what it should be.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct RemoteFault {
    /// Its name.
    pub object: String,
    /// What is wrong with it.
    pub what: String,
}

/// Report of a check.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct RemoteFsckReport {
    /// Runs.
    pub runs: u64,
    /// Records.
    pub records: u64,
    /// Blobs, those in packs among them.
    pub blobs: u64,
    /// Bytes of blobs that were read.
    pub read_bytes: u64,
    /// Sorted by object.
    pub faults: Vec<RemoteFault>,
    /// Whether the faults were removed.
    pub is_repaired: bool,
}

/// A check at work. Memory: some 2 KB a record.
struct Check<'a> {
    bucket: &'a Bucket,
    options: FsckOptions,
    /// Blobs that exist and are whole, as far as checked.
    blobs: HashSet<Digest>,
    records: BTreeMap<Digest, RemoteRecord>,
    faults: BTreeMap<String, String>,
    read_bytes: u64,
}

/// Checks the store. For a repair the caller holds the exclusive lease.
pub(crate) async fn check(bucket: &Bucket, options: FsckOptions) -> Result<RemoteFsckReport, RemoteError> {
    let inventory = Inventory::take(bucket).await?;
    let mut check = Check {
        bucket,
        options,
        blobs: HashSet::new(),
        records: BTreeMap::new(),
        faults: BTreeMap::new(),
        read_bytes: 0,
    };
    check.large(&inventory.blobs).await?;
    check.packs(&inventory.packs).await?;
    let blobs = check.blobs.len() as u64;
    check.records(&inventory.records).await?;
    check.break_records();
    let runs: Vec<&StoredObject> = inventory.runs.values().flatten().collect();
    check.runs(&runs).await?;
    if options.repair {
        check.repair().await?;
    }
    let faults = check.faults.into_iter();
    let faults: Vec<RemoteFault> = faults
        .map(|(object, what)| RemoteFault { object, what })
        .collect();
    Ok(RemoteFsckReport {
        runs: runs.len() as u64,
        records: inventory.records.len() as u64,
        blobs,
        read_bytes: check.read_bytes,
        is_repaired: options.repair && !faults.is_empty(),
        faults,
    })
}

/// Returns the bytes of an object, or empty bytes if it is gone or not a file: these do not have its digest.
async fn bytes_of(bucket: &Bucket, name: &str) -> Result<Bytes, RemoteError> {
    match bucket.get(name).await {
        Err(RemoteError::Damaged { .. }) => Ok(Bytes::new()),
        found => Ok(found?.unwrap_or_default()),
    }
}

impl Check<'_> {
    fn fault(&mut self, object: String, what: impl Into<String>) {
        self.faults.entry(object).or_insert_with(|| what.into());
    }

    async fn large(&mut self, listed: &BTreeMap<Digest, StoredObject>) -> Result<(), RemoteError> {
        self.blobs.extend(listed.keys());
        let (bucket, share) = (self.bucket, self.options.read_data);
        let sample = listed.iter().filter(|(digest, _)| share.has(digest));
        let mut read = stream::iter(sample)
            .map(|(digest, object)| async move {
                Ok::<_, RemoteError>((digest, bytes_of(bucket, &object.name).await?))
            })
            .buffer_unordered(IN_FLIGHT);
        while let Some((digest, bytes)) = read.try_next().await? {
            self.read_bytes += bytes.len() as u64;
            if Digest::from_content(&bytes) != *digest {
                self.blobs.remove(digest);
                self.fault(names::blob(digest), "its bytes have another digest");
            }
        }
        Ok(())
    }

    async fn packs(&mut self, packs: &BTreeMap<Digest, PackFiles>) -> Result<(), RemoteError> {
        for (id, files) in packs.iter().filter(|(_, files)| files.index.is_some()) {
            if let Err(what) = self.pack(id, files).await? {
                self.fault(names::index(id), what);
                if files.pack.is_some() {
                    self.fault(names::pack(id), what);
                }
            }
        }
        Ok(())
    }

    /// Checks a pack, and returns what is wrong with it.
    async fn pack(
        &mut self,
        id: &Digest,
        files: &PackFiles,
    ) -> Result<Result<(), &'static str>, RemoteError> {
        let Some(pack) = &files.pack else {
            return Ok(Err("its pack is not there"));
        };
        let entries = match catalogue::index(self.bucket, id).await {
            Err(RemoteError::Damaged { .. }) => return Ok(Err("its index has another checksum")),
            entries => entries?,
        };
        let end = entries
            .iter()
            .map(|entry| entry.offset + u64::from(entry.len))
            .max();
        if end.unwrap_or(0) != pack.bytes {
            return Ok(Err("the pack is not as long as its index says"));
        }
        if self.options.read_data.has(id) {
            let bytes = bytes_of(self.bucket, &pack.name).await?;
            self.read_bytes += bytes.len() as u64;
            if Digest::from_content(&bytes) != *id {
                return Ok(Err("the bytes of the pack have another digest"));
            }
        }
        self.blobs.extend(entries.iter().map(|entry| entry.digest));
        Ok(Ok(()))
    }

    async fn records(&mut self, listed: &BTreeMap<Digest, StoredObject>) -> Result<(), RemoteError> {
        let bucket = self.bucket;
        let mut read = stream::iter(listed.keys())
            .map(|key| async move { (key, survey::record(bucket, key).await) })
            .buffer_unordered(survey::IN_FLIGHT);
        while let Some((key, record)) = read.next().await {
            match record {
                Ok(record) => self.records.extend(record.map(|record| (*key, record.value))),
                Err(RemoteError::Damaged { what, .. }) => self.fault(names::record(key), what),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Finds the records that name what is not there, and takes them out: what names these is broken too.
    fn break_records(&mut self) {
        loop {
            let named = self.records.values();
            let broken: Vec<(Digest, String)> = named
                .filter_map(|record| Some((record.record.key, self.lacking(&record.keys, &record.blobs)?)))
                .collect();
            if broken.is_empty() {
                return;
            }
            for (key, what) in broken {
                self.records.remove(&key);
                self.fault(names::record(&key), what);
            }
        }
    }

    /// Returns the first missing object of these, in words.
    fn lacking(&self, keys: &[Digest], blobs: &[Digest]) -> Option<String> {
        let key = keys.iter().find(|key| !self.records.contains_key(*key));
        let blob = blobs.iter().find(|blob| !self.blobs.contains(*blob));
        let key = key.map(|key| format!("it names the result of key {key}, which is not there or not whole"));
        key.or_else(|| blob.map(|blob| format!("it names the blob {blob}, which is not there or damaged")))
    }

    async fn runs(&mut self, listed: &[&StoredObject]) -> Result<(), RemoteError> {
        for object in listed {
            let what = match pull::run_named(self.bucket, &object.name).await {
                Ok(run) => self.lacking(&run.value.keys, &run.value.blobs),
                Err(RemoteError::Damaged { what, .. }) => Some(what),
                Err(error) => return Err(error),
            };
            if let Some(what) = what {
                self.fault(object.name.clone(), what);
            }
        }
        Ok(())
    }

    /// Removes objects with a fault: an object before those it names, an index before its pack.
    async fn repair(&self) -> Result<(), RemoteError> {
        let is_in = |folder: &str, name: &str| name.split('/').next() == Some(folder);
        let mut left: BTreeSet<&String> = self.faults.keys().collect();
        for folder in [names::RUNS, names::RECORDS, names::BLOBS, names::PACKS] {
            let (now, later) = left.into_iter().partition(|name| is_in(folder, name));
            left = later;
            let now: BTreeSet<&String> = now;
            for name in now {
                self.bucket.remove(name).await?;
            }
        }
        Ok(())
    }
}

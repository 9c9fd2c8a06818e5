//! A collection: what no kept run needs and nobody has just sent is removed.

use std::{
    collections::{BTreeMap, BTreeSet, HashSet},
    time::{Duration, SystemTime},
};

use futures_util::{StreamExt, TryStreamExt, stream};
use marf_cache::Digest;
use serde::Serialize;

use crate::{
    bucket::{Bucket, StoredObject},
    catalogue,
    error::RemoteError,
    inventory::{Inventory, PackFiles},
    lease::{Lease, age},
    names,
    pack::{Entry, PACK_BYTES, PackWriter},
    pull,
    sealed::SealedValue,
    survey,
};

/// Objects that are removed at once.
const IN_FLIGHT: usize = 32;
/// A pack is rewritten if less than this share of it is needed.
const LEAST_SHARE: f64 = 0.5;

/// Options of a collection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GcOptions {
    /// Number of runs kept of each pipeline. The newest is always kept.
    pub keep_last: usize,
    /// Anything younger is kept, because it may be a result that no run names yet.
    pub grace: Duration,
    /// Whether to report only what would be removed.
    pub dry_run: bool,
}

/// Numbers of objects that a collection has removed, or would remove.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct RemoteGcReport {
    /// Runs.
    pub runs: u64,
    /// Records.
    pub records: u64,
    /// Large blobs.
    pub blobs: u64,
    /// Packs, including those that were rewritten.
    pub packs: u64,
    /// Packs that were written with the needed blobs of others.
    pub new_packs: u64,
    /// Bytes of everything that was removed.
    pub removed_bytes: u64,
    /// Bytes of what stays.
    pub kept_bytes: u64,
    /// Records that kept runs name and that are not there: see `fsck`.
    pub missing: u64,
}

/// What must stay.
#[derive(Default)]
struct LiveObjects {
    keys: HashSet<Digest>,
    blobs: HashSet<Digest>,
    missing: u64,
}

/// A pack with the entries of its index.
struct IndexedPack {
    id: Digest,
    files: PackFiles,
    entries: Vec<Entry>,
}

/// A collection at work.
struct Collection<'a> {
    bucket: &'a Bucket,
    options: GcOptions,
    now: SystemTime,
    done: RemoteGcReport,
}

/// Collects. The caller holds the exclusive lease, unless it is a dry run.
pub(crate) async fn collect(
    bucket: &Bucket,
    lease: &Lease,
    options: GcOptions,
) -> Result<RemoteGcReport, RemoteError> {
    let now = lease.now(bucket).await?;
    let inventory = Inventory::take(bucket).await?;
    let mut collection = Collection {
        bucket,
        options,
        now,
        done: RemoteGcReport::default(),
    };
    let (kept, given_up) = collection.runs(&inventory);
    let live = collection.mark(&inventory, &kept).await?;
    collection.done.missing = live.missing;
    // Who names goes before what is named.
    collection.done.runs = collection.remove(given_up.into_iter()).await?;
    let records = without(&inventory.records, &live.keys);
    collection.done.records = collection.remove(records).await?;
    let blobs = without(&inventory.blobs, &live.blobs);
    collection.done.blobs = collection.remove(blobs).await?;
    let stays = inventory
        .blobs
        .iter()
        .filter(|(digest, _)| live.blobs.contains(*digest));
    collection.done.kept_bytes += stays.map(|(_, object)| object.bytes).sum::<u64>();
    collection.packs(inventory.packs, &live.blobs).await?;
    if !options.dry_run {
        Lease::sweep(bucket, now).await?;
    }
    Ok(collection.done)
}

/// Returns the objects that are not live.
fn without(
    objects: &BTreeMap<Digest, StoredObject>,
    live: &HashSet<Digest>,
) -> impl Iterator<Item = StoredObject> {
    let dead = objects.iter().filter(|(digest, _)| !live.contains(*digest));
    dead.map(|(_, object)| object.clone())
}

impl Collection<'_> {
    fn is_old(&self, object: &StoredObject) -> bool {
        age(self.now, object.modified) >= self.options.grace
    }

    /// Returns the runs that are kept and those that are given up.
    fn runs(&self, inventory: &Inventory) -> (Vec<StoredObject>, Vec<StoredObject>) {
        let (mut kept, mut given_up) = (Vec::new(), Vec::new());
        for runs in inventory.runs.values() {
            for (at, run) in runs.iter().enumerate() {
                if at >= self.options.keep_last.max(1) && self.is_old(run) {
                    given_up.push(run.clone())
                } else {
                    kept.push(run.clone())
                }
            }
        }
        (kept, given_up)
    }

    /// Follows what kept runs and young records name.
    async fn mark(&self, inventory: &Inventory, kept: &[StoredObject]) -> Result<LiveObjects, RemoteError> {
        let mut live = LiveObjects::default();
        let young = inventory
            .records
            .iter()
            .filter(|(_, record)| !self.is_old(record));
        let mut level: BTreeSet<Digest> = young.map(|(key, _)| *key).collect();
        for object in kept {
            let run = pull::run_named(self.bucket, &object.name).await?.value;
            level.extend(run.keys);
            live.blobs.extend(run.blobs);
        }
        while !level.is_empty() {
            live.keys.extend(level.iter().copied());
            let mut below = BTreeSet::new();
            for (_, record) in survey::records(self.bucket, level.into_iter()).await? {
                match record {
                    None => live.missing += 1,
                    Some(SealedValue { value: record, .. }) => {
                        live.blobs.extend(record.blobs);
                        below.extend(record.keys);
                    }
                }
            }
            below.retain(|key| !live.keys.contains(key));
            level = below;
        }
        Ok(live)
    }

    /// Removes those objects that are old, and returns their number.
    async fn remove(&mut self, objects: impl Iterator<Item = StoredObject>) -> Result<u64, RemoteError> {
        let old: Vec<StoredObject> = objects.filter(|object| self.is_old(object)).collect();
        self.done.removed_bytes += old.iter().map(|object| object.bytes).sum::<u64>();
        if !self.options.dry_run {
            let bucket = self.bucket;
            stream::iter(&old)
                .map(|object| bucket.remove(&object.name))
                .buffer_unordered(IN_FLIGHT)
                .try_collect::<()>()
                .await?;
        }
        Ok(old.len() as u64)
    }

    /// Removes packs without a needed blob, and rewrites the needed blobs of packs that are small or mostly not
    /// needed.
    async fn packs(
        &mut self,
        packs: BTreeMap<Digest, PackFiles>,
        live: &HashSet<Digest>,
    ) -> Result<(), RemoteError> {
        let mut merged = Vec::new();
        for (id, files) in packs {
            let entries = match &files.index {
                Some(_) => catalogue::index(self.bucket, &id).await?,
                None => Vec::new(),
            };
            let pack = IndexedPack { id, files, entries };
            let objects = || pack.objects();
            let is_old = objects().all(|object| self.is_old(object));
            match pack.needed_bytes(live) {
                0 if is_old => self.remove_pack(&pack).await?,
                _ if is_old && (pack.len() < PACK_BYTES / 2 || pack.is_mostly_unneeded(live)) => {
                    merged.push(pack)
                }
                _ => self.done.kept_bytes += pack.bytes(),
            }
        }
        self.merge(merged, live).await
    }

    async fn remove_pack(&mut self, pack: &IndexedPack) -> Result<(), RemoteError> {
        // The index goes first: nobody then looks for the pack.
        self.remove(pack.files.index.clone().into_iter()).await?;
        self.remove(pack.files.pack.clone().into_iter()).await?;
        self.done.packs += 1;
        Ok(())
    }

    /// Writes what is needed of packs to new ones, then removes the old ones.
    async fn merge(&mut self, packs: Vec<IndexedPack>, live: &HashSet<Digest>) -> Result<(), RemoteError> {
        // One small pack alone would only be copied.
        if let [pack] = packs.as_slice()
            && !pack.is_mostly_unneeded(live)
        {
            self.done.kept_bytes += pack.bytes();
            return Ok(());
        }
        self.done.kept_bytes += packs.iter().map(|pack| pack.needed_bytes(live)).sum::<u64>();
        let mut new = HashSet::new();
        if !self.options.dry_run {
            let mut left = live.clone();
            let mut writer = PackWriter::default();
            for pack in &packs {
                pack.move_to(self.bucket, &mut left, &mut writer).await?;
                if writer.len() >= PACK_BYTES {
                    new.insert(self.bucket.put_pack(std::mem::take(&mut writer).finish()).await?);
                }
            }
            if writer.len() > 0 {
                new.insert(self.bucket.put_pack(writer.finish()).await?);
            }
        }
        self.done.new_packs = new.len() as u64;
        // A pack of the same blobs in the same order is the same pack.
        for pack in packs.iter().filter(|pack| !new.contains(&pack.id)) {
            self.remove_pack(pack).await?;
        }
        Ok(())
    }
}

impl IndexedPack {
    fn objects(&self) -> impl Iterator<Item = &StoredObject> {
        self.files.pack.iter().chain(&self.files.index)
    }

    fn bytes(&self) -> u64 {
        self.objects().map(|object| object.bytes).sum()
    }

    fn needed(&self, live: &HashSet<Digest>) -> impl Iterator<Item = &Entry> {
        self.entries.iter().filter(|entry| live.contains(&entry.digest))
    }

    fn needed_bytes(&self, live: &HashSet<Digest>) -> u64 {
        self.needed(live).map(|entry| u64::from(entry.len)).sum()
    }

    /// Returns the length of the pack itself.
    fn len(&self) -> u64 {
        self.files.pack.as_ref().map_or(0, |pack| pack.bytes)
    }

    fn is_mostly_unneeded(&self, live: &HashSet<Digest>) -> bool {
        (self.needed_bytes(live) as f64) < LEAST_SHARE * self.len() as f64
    }

    /// Moves the remaining blobs of this pack to another. A blob that several packs have is moved once.
    async fn move_to(
        &self,
        bucket: &Bucket,
        left: &mut HashSet<Digest>,
        to: &mut PackWriter,
    ) -> Result<(), RemoteError> {
        let name = names::pack(&self.id);
        let bytes = bucket.get(&name).await?;
        let bytes = bytes.ok_or_else(|| bucket.damaged(&name, "its index is there, and it is not"))?;
        for entry in &self.entries {
            if !left.remove(&entry.digest) {
                continue;
            }
            let blob = entry
                .bytes_in(&bytes)
                .filter(|blob| Digest::from_content(blob) == entry.digest);
            let what = format!("it does not hold the blob {}", entry.digest.short());
            to.add(entry.digest, blob.ok_or_else(|| bucket.damaged(&name, &what))?);
        }
        Ok(())
    }
}

//! Fetches blobs from a shared store into the local one and checks each by its digest.

use std::{
    collections::{BTreeMap, BTreeSet},
    iter,
    num::NonZero,
    panic::resume_unwind,
    thread,
};

use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, future, stream};
use marf_cache::{Digest, Store};

use crate::{bucket::Bucket, catalogue, error::RemoteError, names, observer::Meter, pack::Entry, presence};

/// Large blobs, or windows of packs, that are fetched at once.
const IN_FLIGHT: usize = 16;
/// Bytes of a pack that are fetched together.
const WINDOW_BYTES: u64 = 8 << 20;

/// Blobs by where they are.
pub(crate) struct Plan {
    large: BTreeMap<Digest, u64>,
    windows: Vec<Window>,
}

/// Blobs that are near to each other in one pack.
struct Window {
    pack: Digest,
    entries: Vec<Entry>,
}

impl Plan {
    /// Finds blobs: in packs, or else as objects.
    pub(crate) async fn make(bucket: &Bucket, wanted: &BTreeSet<Digest>) -> Result<Self, RemoteError> {
        let packed = catalogue::in_packs(bucket, wanted.iter()).await?;
        let mut others = wanted.clone();
        for entry in packed.values().flatten() {
            others.remove(&entry.digest);
        }
        Ok(Self {
            windows: packed
                .into_iter()
                .flat_map(|(pack, entries)| windows(pack, entries))
                .collect(),
            large: large(bucket, others).await?,
        })
    }

    /// Returns the bytes of all blobs.
    pub(crate) fn bytes(&self) -> u64 {
        let entries = self.windows.iter().flat_map(|window| &window.entries);
        let small: u64 = entries.map(|entry| u64::from(entry.len)).sum();
        small + self.large.values().sum::<u64>()
    }

    /// Fetches the blobs.
    pub(crate) async fn fetch(
        &self,
        bucket: &Bucket,
        store: &Store,
        meter: &Meter<'_>,
    ) -> Result<(), RemoteError> {
        stream::iter(&self.windows)
            .map(|window| async move { window.fetch(bucket, store, meter).await })
            .buffer_unordered(IN_FLIGHT)
            .try_collect::<()>()
            .await?;
        stream::iter(&self.large)
            .map(|(digest, bytes)| async move {
                let name = names::blob(digest);
                let blob = bucket.get(&name).await?;
                Ok(FetchedBlob {
                    name,
                    digest: *digest,
                    bytes: *bytes,
                    blob,
                })
            })
            .buffer_unordered(IN_FLIGHT)
            .try_ready_chunks(IN_FLIGHT)
            .map_err(|error| error.1)
            .try_for_each(|blobs| future::ready(keep(bucket, store, &blobs, meter)))
            .await
    }
}

/// A blob as it came.
struct FetchedBlob {
    /// The object that it is from.
    name: String,
    digest: Digest,
    bytes: u64,
    /// None if it was not there.
    blob: Option<Bytes>,
}

impl Window {
    async fn fetch(&self, bucket: &Bucket, store: &Store, meter: &Meter<'_>) -> Result<(), RemoteError> {
        let name = names::pack(&self.pack);
        let range = |entry: &Entry| entry.offset..entry.offset + u64::from(entry.len);
        let ranges: Vec<_> = self.entries.iter().map(range).collect();
        let Some(parts) = bucket.get_ranges(&name, &ranges).await? else {
            catalogue::forget(bucket).await;
            return Err(bucket.damaged(&name, "its index is there, and it is not"));
        };
        let parts = parts.into_iter().map(Some).chain(iter::repeat(None));
        let pairs = self.entries.iter().zip(parts);
        let blobs = pairs.map(|(entry, blob)| FetchedBlob {
            name: name.clone(),
            digest: entry.digest,
            bytes: u64::from(entry.len),
            blob,
        });
        keep(bucket, store, &blobs.collect::<Vec<_>>(), meter)
    }
}

/// Reads one blob, whose bytes are not checked: of a pack that is known, as an object, or of a pack that has come since. None
/// if it is not there.
pub(crate) async fn blob(bucket: &Bucket, digest: &Digest) -> Result<Option<Bytes>, RemoteError> {
    if let Some((pack, entry)) = catalogue::known(bucket, digest).await {
        match packed(bucket, &pack, &entry).await? {
            None => catalogue::forget(bucket).await,
            bytes => return Ok(bytes),
        }
    }
    if let Some(bytes) = bucket.get(&names::blob(digest)).await? {
        return Ok(Some(bytes));
    }
    let found = catalogue::in_packs(bucket, std::iter::once(digest)).await?;
    let found = found
        .iter()
        .find_map(|(pack, entries)| Some((pack, entries.first()?)));
    match found {
        Some((pack, entry)) => packed(bucket, pack, entry).await,
        None => Ok(None),
    }
}

async fn packed(bucket: &Bucket, pack: &Digest, entry: &Entry) -> Result<Option<Bytes>, RemoteError> {
    let range = entry.offset..entry.offset + u64::from(entry.len);
    let parts = bucket
        .get_ranges(&names::pack(pack), std::slice::from_ref(&range))
        .await?;
    Ok(parts.and_then(|parts| parts.into_iter().next()))
}

/// Stores fetched blobs, if each has its digest, on all cores: hashing and writing them takes longer than fetching them from a folder or
/// from a near server.
///
/// It starts its own threads: a thread of rayon's pool could start another node's work here, which must not wait for a fetch inside of
/// this one.
fn keep(bucket: &Bucket, store: &Store, blobs: &[FetchedBlob], meter: &Meter<'_>) -> Result<(), RemoteError> {
    let cores = thread::available_parallelism().map_or(1, NonZero::get);
    let share = blobs.len().div_ceil(cores).max(1);
    let keep_all = |blobs: &[FetchedBlob]| {
        blobs
            .iter()
            .try_for_each(|blob| keep_one(bucket, store, blob, meter))
    };
    thread::scope(|scope| {
        let shares: Vec<_> = blobs
            .chunks(share)
            .map(|share| scope.spawn(move || keep_all(share)))
            .collect();
        shares
            .into_iter()
            .try_for_each(|share| share.join().unwrap_or_else(|panic| resume_unwind(panic)))
    })
}

fn keep_one(
    bucket: &Bucket,
    store: &Store,
    arrived: &FetchedBlob,
    meter: &Meter<'_>,
) -> Result<(), RemoteError> {
    let FetchedBlob {
        name,
        digest,
        bytes,
        blob,
    } = arrived;
    let blob = blob.as_ref().ok_or_else(|| missing(bucket, digest))?;
    // `put` hashes the bytes and stores them under their own digest. No record names bytes of another digest.
    if store.put(blob)? != *digest {
        let what = format!("its {} bytes are not the blob {}", blob.len(), digest.short());
        return Err(bucket.damaged(name, &what));
    }
    meter.add(*bytes);
    Ok(())
}

fn missing(bucket: &Bucket, digest: &Digest) -> RemoteError {
    RemoteError::Missing {
        place: bucket.place.clone(),
        what: "blob",
        digest: *digest,
    }
}

/// Divides blobs of a pack by their places.
fn windows(pack: Digest, mut entries: Vec<Entry>) -> Vec<Window> {
    entries.sort_unstable_by_key(|entry| entry.offset);
    let near = entries.chunk_by(|a, b| a.offset / WINDOW_BYTES == b.offset / WINDOW_BYTES);
    near.map(|entries| Window {
        pack,
        entries: entries.to_vec(),
    })
    .collect()
}

/// Returns the lengths of large blobs. A missing blob is an error.
async fn large(bucket: &Bucket, digests: BTreeSet<Digest>) -> Result<BTreeMap<Digest, u64>, RemoteError> {
    let there = presence::sizes(bucket, digests.iter().copied()).await?;
    let sized = digests.into_iter().map(|digest| {
        let bytes = there.get(&digest).ok_or_else(|| missing(bucket, &digest))?;
        Ok((digest, *bytes))
    });
    sized.collect()
}

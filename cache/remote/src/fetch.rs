//! Blobs from a shared store into the own one, each checked by its digest.

use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use marf_cache::{Digest, Store};

use crate::{
    bucket::Bucket,
    catalogue::{Catalogue, Place},
    error::RemoteError,
    names,
    push::Meter,
};

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
    places: Vec<Place>,
}

impl Plan {
    /// Finds blobs: in packs, or else as objects.
    pub(crate) async fn make(bucket: &Bucket, wanted: &BTreeSet<Digest>) -> Result<Self, RemoteError> {
        if wanted.is_empty() {
            return Ok(Self {
                large: BTreeMap::new(),
                windows: Vec::new(),
            });
        }
        let catalogue = Catalogue::load(bucket).await?;
        let mut packed: BTreeMap<u32, Vec<Place>> = BTreeMap::new();
        let mut others = Vec::new();
        for digest in wanted {
            match catalogue.find(digest) {
                Some(place) => packed.entry(place.pack).or_default().push(place),
                None => others.push(*digest),
            }
        }
        let windows = packed.into_iter().filter_map(|(pack, places)| {
            let pack = *catalogue.packs.get(pack as usize)?;
            Some(windows(pack, places))
        });
        Ok(Self {
            windows: windows.flatten().collect(),
            large: sizes(bucket, others).await?,
        })
    }

    /// Returns the bytes of all blobs.
    pub(crate) fn bytes(&self) -> u64 {
        let places = self.windows.iter().flat_map(|window| &window.places);
        let small: u64 = places.map(|place| u64::from(place.entry.len)).sum();
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
                keep(bucket, store, &name, digest, blob)?;
                meter.add(*bytes);
                Ok(())
            })
            .buffer_unordered(IN_FLIGHT)
            .try_collect()
            .await
    }
}

impl Window {
    async fn fetch(&self, bucket: &Bucket, store: &Store, meter: &Meter<'_>) -> Result<(), RemoteError> {
        let name = names::pack(&self.pack);
        let ranges: Vec<_> = self
            .places
            .iter()
            .map(|place| place.entry.offset..place.entry.offset + u64::from(place.entry.len))
            .collect();
        let parts = bucket.get_ranges(&name, &ranges).await?.unwrap_or_default();
        let mut parts = parts.into_iter();
        for place in &self.places {
            keep(bucket, store, &name, &place.entry.digest, parts.next())?;
            meter.add(u64::from(place.entry.len));
        }
        Ok(())
    }
}

/// Stores a blob that has arrived, if it has its digest.
fn keep(
    bucket: &Bucket,
    store: &Store,
    name: &str,
    digest: &Digest,
    blob: Option<Bytes>,
) -> Result<(), RemoteError> {
    let Some(blob) = blob else {
        return Err(missing(bucket, digest));
    };
    if Digest::of(&blob) != *digest {
        let what = format!("its {} bytes are not the blob {}", blob.len(), digest.short());
        return Err(bucket.damaged(name, &what));
    }
    store.put(&blob)?;
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
fn windows(pack: Digest, mut places: Vec<Place>) -> Vec<Window> {
    places.sort_unstable_by_key(|place| place.entry.offset);
    let near = places.chunk_by(|a, b| a.entry.offset / WINDOW_BYTES == b.entry.offset / WINDOW_BYTES);
    near.map(|places| Window {
        pack,
        places: places.to_vec(),
    })
    .collect()
}

/// Returns the lengths of large blobs.
async fn sizes(bucket: &Bucket, digests: Vec<Digest>) -> Result<BTreeMap<Digest, u64>, RemoteError> {
    stream::iter(digests)
        .map(|digest| async move {
            let found = bucket.find(&names::blob(&digest)).await?;
            Ok((digest, found.ok_or_else(|| missing(bucket, &digest))?.bytes))
        })
        .buffer_unordered(IN_FLIGHT)
        .try_collect()
        .await
}

//! Where small blobs are: the indexes of all packs as one sorted list, 48 bytes a blob.

use futures_util::{StreamExt, TryStreamExt, stream};
use marf_cache::Digest;

use crate::{
    bucket::Bucket,
    error::RemoteError,
    names,
    pack::{Entry, decode_index},
};

/// Indexes that are fetched at once.
const IN_FLIGHT: usize = 16;

/// Where a blob is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Place {
    pub(crate) entry: Entry,
    /// Number of its pack.
    pub(crate) pack: u32,
}

/// The small blobs of a shared store.
#[derive(Default)]
pub(crate) struct Catalogue {
    pub(crate) packs: Vec<Digest>,
    places: Vec<Place>,
}

impl Catalogue {
    /// Fetches all indexes.
    pub(crate) async fn load(bucket: &Bucket) -> Result<Self, RemoteError> {
        let listed = bucket.list(names::PACKS).await?;
        let mut packs: Vec<Digest> = listed
            .iter()
            .filter_map(|object| names::pack_of_index(&object.name))
            .collect();
        packs.sort_unstable();
        let indexes = stream::iter(packs.iter().zip(0_u32..))
            .map(|(pack, number)| async move { Ok::<_, RemoteError>((number, index(bucket, pack).await?)) })
            .buffer_unordered(IN_FLIGHT)
            .try_collect::<Vec<_>>()
            .await?;
        let mut places: Vec<Place> = indexes
            .into_iter()
            .flat_map(|(pack, entries)| entries.into_iter().map(move |entry| Place { entry, pack }))
            .collect();
        places.sort_unstable();
        places.dedup_by_key(|place| place.entry.digest);
        Ok(Self { packs, places })
    }

    /// Returns where a blob is; none if it is in no pack.
    pub(crate) fn find(&self, digest: &Digest) -> Option<Place> {
        let at = self
            .places
            .binary_search_by(|place| place.entry.digest.cmp(digest))
            .ok()?;
        self.places.get(at).copied()
    }
}

/// Returns the entries of an index; none of one that a collection has removed since it was listed.
pub(crate) async fn index(bucket: &Bucket, pack: &Digest) -> Result<Vec<Entry>, RemoteError> {
    let name = names::index(pack);
    match bucket.get(&name).await? {
        None => Ok(Vec::new()),
        Some(bytes) => decode_index(&bytes).ok_or_else(|| bucket.damaged(&name, "its checksum is another")),
    }
}

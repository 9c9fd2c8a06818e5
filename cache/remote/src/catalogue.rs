//! Places of small blobs: the indexes of all packs are read when a blob is in no known index.

use std::collections::{BTreeMap, BTreeSet};

use futures_util::{StreamExt, TryStreamExt, stream};
use marf_cache::Digest;

use crate::{
    bucket::Bucket,
    error::RemoteError,
    names,
    pack::{Catalogue, Entry, decode_index},
};

/// Indexes that are fetched at once.
const IN_FLIGHT: usize = 16;

/// Returns those blobs that are in packs, by pack. New indexes are read if one is not known yet.
pub(crate) async fn in_packs(
    bucket: &Bucket,
    wanted: impl Iterator<Item = &Digest> + Clone,
) -> Result<BTreeMap<Digest, Vec<Entry>>, RemoteError> {
    let mut catalogue = bucket.catalogue.lock().await;
    if wanted.clone().any(|digest| catalogue.find(digest).is_none()) {
        refresh(bucket, &mut catalogue).await?;
    }
    let mut packs: BTreeMap<Digest, Vec<Entry>> = BTreeMap::new();
    for (entry, pack) in wanted.filter_map(|digest| catalogue.find(digest)) {
        packs.entry(pack).or_default().push(entry);
    }
    Ok(packs)
}

/// Returns pack and entry of a blob, if an index that was read lists it.
pub(crate) async fn known(bucket: &Bucket, digest: &Digest) -> Option<(Digest, Entry)> {
    let catalogue = bucket.catalogue.lock().await;
    let (entry, pack) = catalogue.find(digest)?;
    Some((pack, entry))
}

/// Forgets all indexes: a pack that one names is gone.
pub(crate) async fn forget(bucket: &Bucket) {
    *bucket.catalogue.lock().await = Catalogue::default();
}

/// Reads the indexes of packs that are new.
async fn refresh(bucket: &Bucket, catalogue: &mut Catalogue) -> Result<(), RemoteError> {
    let known: BTreeSet<Digest> = catalogue.packs().iter().copied().collect();
    let listed = bucket.list(names::PACKS).await?;
    let packs = listed
        .iter()
        .filter_map(|object| names::pack_of_index(&object.name));
    let packs: BTreeSet<Digest> = packs.collect();
    let new = packs.difference(&known).copied();
    let mut indexes: Vec<(Digest, Vec<Entry>)> = stream::iter(new)
        .map(|pack| async move { Ok::<_, RemoteError>((pack, index(bucket, &pack).await?)) })
        .buffer_unordered(IN_FLIGHT)
        .try_collect()
        .await?;
    indexes.sort_unstable();
    catalogue.add(indexes);
    Ok(())
}

/// Returns the entries of an index, or an empty list if a collection has removed it since it was listed.
pub(crate) async fn index(bucket: &Bucket, pack: &Digest) -> Result<Vec<Entry>, RemoteError> {
    let name = names::index(pack);
    match bucket.get(&name).await? {
        None => Ok(Vec::new()),
        Some(bytes) => decode_index(&bytes).ok_or_else(|| bucket.damaged(&name, "its checksum is another")),
    }
}

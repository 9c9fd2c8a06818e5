//! All objects of a shared store by their names, for collections and checks: some 100 bytes of memory an object.

use std::collections::BTreeMap;

use marf_cache::Digest;

use crate::{
    bucket::{Bucket, StoredObject},
    error::RemoteError,
    names,
};

/// All objects of a shared store.
pub(crate) struct Inventory {
    /// Runs with their starts, by pipeline, the newest first.
    pub(crate) runs: BTreeMap<String, Vec<StoredObject>>,
    pub(crate) records: BTreeMap<Digest, StoredObject>,
    /// Large blobs.
    pub(crate) blobs: BTreeMap<Digest, StoredObject>,
    pub(crate) packs: BTreeMap<Digest, PackFiles>,
}

/// The objects of a pack. Without an index, no blob of the pack can be found.
#[derive(Default)]
pub(crate) struct PackFiles {
    pub(crate) pack: Option<StoredObject>,
    pub(crate) index: Option<StoredObject>,
}

impl Inventory {
    /// Lists all objects.
    pub(crate) async fn take(bucket: &Bucket) -> Result<Self, RemoteError> {
        let by_digest = |listed: Vec<StoredObject>| {
            let named = listed.into_iter();
            named
                .filter_map(|object| Some((names::digest_in(&object.name)?, object)))
                .collect()
        };
        Ok(Self {
            // Records before blobs: what a push adds meanwhile is then not taken for something that is missing.
            runs: runs(bucket.list(names::RUNS).await?),
            records: by_digest(bucket.list(names::RECORDS).await?),
            blobs: by_digest(bucket.list(names::BLOBS).await?),
            packs: packs(bucket.list(names::PACKS).await?),
        })
    }
}

fn runs(listed: Vec<StoredObject>) -> BTreeMap<String, Vec<StoredObject>> {
    let mut runs: BTreeMap<String, Vec<StoredObject>> = BTreeMap::new();
    for object in listed
        .into_iter()
        .filter(|object| names::run_in(&object.name).is_some())
    {
        let folder = object.name.rsplit_once('/').map_or("", |(folder, _)| folder);
        runs.entry(folder.to_owned()).or_default().push(object);
    }
    for of_pipeline in runs.values_mut() {
        of_pipeline.sort_by(|a, b| b.name.cmp(&a.name));
    }
    runs
}

fn packs(listed: Vec<StoredObject>) -> BTreeMap<Digest, PackFiles> {
    let mut packs: BTreeMap<Digest, PackFiles> = BTreeMap::new();
    for object in listed {
        if let Some(id) = names::pack_of_index(&object.name) {
            packs.entry(id).or_default().index = Some(object);
        } else if let Some(id) = names::pack_in(&object.name) {
            packs.entry(id).or_default().pack = Some(object);
        }
    }
    packs
}

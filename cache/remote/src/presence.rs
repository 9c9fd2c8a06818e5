//! Which large blobs are there.

use std::collections::BTreeMap;

use futures_util::{StreamExt, TryStreamExt, stream};
use marf_cache::Digest;

use crate::{bucket::Bucket, error::RemoteError, names, survey};

/// From this many blobs of one folder on the folder is listed, instead of asking for each.
const LIST_FROM: usize = 4;

/// Returns the lengths of those large blobs that are there, and perhaps of others.
pub(crate) async fn sizes(
    bucket: &Bucket,
    digests: impl Iterator<Item = Digest>,
) -> Result<BTreeMap<Digest, u64>, RemoteError> {
    let mut folders: BTreeMap<String, Vec<Digest>> = BTreeMap::new();
    for digest in digests {
        let name = names::blob(&digest);
        let folder = name.rsplit_once('/').map_or("", |(folder, _)| folder);
        folders.entry(folder.to_owned()).or_default().push(digest);
    }
    let found: Vec<Vec<(Digest, u64)>> = stream::iter(folders)
        .map(|(folder, digests)| async move { sizes_in(bucket, &folder, digests).await })
        .buffer_unordered(survey::IN_FLIGHT)
        .try_collect()
        .await?;
    Ok(found.into_iter().flatten().collect())
}

async fn sizes_in(
    bucket: &Bucket,
    folder: &str,
    wanted: Vec<Digest>,
) -> Result<Vec<(Digest, u64)>, RemoteError> {
    let mut listed = Vec::new();
    if wanted.len() >= LIST_FROM {
        listed = bucket.list(folder).await?;
    } else {
        for digest in wanted {
            listed.extend(bucket.find(&names::blob(&digest)).await?);
        }
    }
    let sized = |object: crate::bucket::StoredObject| Some((names::digest_in(&object.name)?, object.bytes));
    Ok(listed.into_iter().filter_map(sized).collect())
}

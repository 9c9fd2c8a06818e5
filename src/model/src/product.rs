//! Products that a source read, and where their files came from.

use std::collections::BTreeMap;

use marf_cache::{
    Digest, Record, Store,
    manifest::{Leaf, LeafRef, Root},
};
use marf_stage::{Origin, PHOTOS};
use serde::Serialize;

use crate::error::RunError;

/// The part of a source that read one sol.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SourcePart {
    /// The sol, or 0 without one.
    pub shard: u32,
    /// Key of the part's record.
    pub key: Digest,
}

/// A photo with its label, as it was read from an archive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Product {
    /// The product id, or the name of the file.
    pub id: String,
    /// The sol that it was listed under, or 0 without one.
    #[serde(rename = "sol")]
    pub shard: u32,
    /// Digests of its blobs by role: `image`, and where there are `raw`, `label`, `thumbnail`.
    pub blobs: BTreeMap<String, Digest>,
    /// What later stages know of it, as JSON (`marf_scene::PhotoFacts`).
    #[serde(skip)]
    pub facts: serde_json::Value,
    /// The files that its blobs are, by role. A blob that was made of another has none.
    #[serde(rename = "files")]
    pub origins: BTreeMap<String, Origin>,
}

/// Returns the parts of a record, by sol. For a node that is not a source they are its own work on each sol.
///
/// # Errors
/// Returns an error if the list of parts is lost or the store cannot be read.
pub fn parts_of(store: &Store, record: &Record) -> Result<Vec<SourcePart>, RunError> {
    let Some(parts) = record.parts else {
        return Ok(Vec::new());
    };
    let part = |leaf: LeafRef| SourcePart {
        shard: leaf.shard,
        key: leaf.leaf,
    };
    Ok(set(store, &parts)?.leaves.into_iter().map(part).collect())
}

/// Reads a set.
///
/// # Errors
/// A block that is lost, or a store that cannot be read.
pub fn set(store: &Store, root: &Digest) -> Result<Root, RunError> {
    Root::read(root, |digest| Ok(store.get(digest)?))
}

/// Returns the files that a part of a source read, or an empty list if it records no files.
///
/// # Errors
/// Returns an error if a record or list is lost or the store cannot be read.
pub fn origins(store: &Store, part: &SourcePart) -> Result<Vec<Origin>, RunError> {
    match record_of(store, part)?.origins {
        None => Ok(Vec::new()),
        Some(list) => Origin::decode(&store.get(&list)?).map_err(|error| RunError::Malformed {
            what: format!("the list of files of sol {}", part.shard),
            message: error.to_string(),
        }),
    }
}

/// Returns the products that a part of a source gave, sorted by id.
///
/// # Errors
/// A record or leaf that is lost, or a store that cannot be read.
pub fn products(store: &Store, part: &SourcePart) -> Result<Vec<Product>, RunError> {
    let record = record_of(store, part)?;
    let by_digest: BTreeMap<Digest, Origin> = origins(store, part)?
        .into_iter()
        .filter(|origin| origin.bytes.is_some())
        .map(|origin| (origin.blake3, origin))
        .collect();
    let mut products = Vec::new();
    for leaf in leaves(store, &record)? {
        for row in Leaf::decode(&store.get(&leaf.leaf)?)?.rows {
            let blobs = row.blobs.iter();
            let origins =
                blobs.filter_map(|(role, digest)| Some((role.clone(), by_digest.get(digest)?.clone())));
            products.push(Product {
                shard: part.shard,
                origins: origins.collect(),
                id: row.id,
                blobs: row.blobs,
                facts: row.facts,
            });
        }
    }
    Ok(products)
}

/// Returns the leaves of the photos of a part.
fn leaves(store: &Store, record: &Record) -> Result<Vec<LeafRef>, RunError> {
    match record.outputs.get(PHOTOS) {
        None => Ok(Vec::new()),
        Some(photos) => Ok(Root::decode_leaves(&store.get(&photos.digest)?)?),
    }
}

fn record_of(store: &Store, part: &SourcePart) -> Result<Record, RunError> {
    store.record(&part.key)?.ok_or_else(|| RunError::NoRecord {
        what: format!("sol {}", part.shard),
        key: part.key,
    })
}

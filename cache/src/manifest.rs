//! Merkle manifests: a set of items as leaves of sorted rows, shard (sol) by shard.
//!
//! A set is a sorted list of (shard, digest of a leaf). A leaf is up to [`ROWS_A_LEAF`] rows sorted by id. The list is
//! stored in blocks of [`SHARDS_A_BLOCK`] shards below one root, so that a new sol writes its leaf, one block and the root.
//! Sets of equal roots are equal, and equal blocks and leaves need not be read.
//!
//! Verdicts by shard, the parts of a node by shard and the listing of a source have the same form. Their "leaves" are
//! blobs of verdicts, keys of parts, fingerprints.

use std::{collections::BTreeMap, sync::Arc};

use serde::{Deserialize, Serialize};

use crate::Digest;

/// Most rows of one leaf: 4,000 rows of some hundred bytes stay under a megabyte.
pub const ROWS_A_LEAF: usize = 4_000;
/// Shard numbers of one block: a mission of 4,000 sols has 63 blocks of 64 lines.
pub const SHARDS_A_BLOCK: u32 = 64;

/// One item of a set: its name, its blobs, and facts about it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the item, unique in its set (a product id, or a file name).
    pub id: String,
    /// Digests of the item's blobs by role (`image`, `label`, `raw`).
    pub blobs: BTreeMap<String, Digest>,
    /// Facts about the item as canonical JSON (keys sorted, no clock, no path of this machine).
    #[serde(default, skip_serializing_if = "serde_json::Value::is_null")]
    pub facts: serde_json::Value,
}

/// Rows of one shard, sorted by id.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Leaf {
    /// Sorted by id, each id once.
    pub rows: Vec<Row>,
}

/// A whole set: its leaves in order.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Root {
    /// Sorted by shard, then by the first id of the leaf.
    pub leaves: Vec<LeafRef>,
}

/// A reference to a leaf.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeafRef {
    /// The sol, or 0 if a set has none.
    pub shard: u32,
    /// Digest of the encoded leaf.
    pub leaf: Digest,
    /// Number of rows.
    pub rows: u32,
}

/// A line of a root: the leaves of the shards from `block * SHARDS_A_BLOCK` on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BlockRef {
    /// Number of the block.
    pub block: u32,
    /// Digest of the list of its leaves.
    pub digest: Digest,
    /// Number of leaves.
    pub leaves: u32,
    /// Number of rows in all leaves.
    pub rows: u64,
}

/// A manifest that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ManifestError {
    /// The bytes are not a manifest.
    #[error("not a manifest: {0}")]
    Malformed(#[from] serde_json::Error),
    /// Rows are not sorted or an id occurs twice.
    #[error("row `{id}` is out of order or a repetition")]
    Unsorted {
        /// The row's id.
        id: String,
    },
}

/// For readers whose errors are texts for people.
impl From<ManifestError> for String {
    fn from(error: ManifestError) -> Self {
        error.to_string()
    }
}

impl Leaf {
    /// Sorts rows into a leaf. Every id may occur once.
    ///
    /// # Errors
    /// Names an id that occurs twice.
    pub fn new(mut rows: Vec<Row>) -> Result<Self, ManifestError> {
        rows.sort_by(|a, b| a.id.cmp(&b.id));
        let leaf = Self { rows };
        leaf.check()?;
        Ok(leaf)
    }

    /// Returns the canonical bytes: one row a line, as JSON.
    pub fn encode(&self) -> Vec<u8> {
        encode_lines(&self.rows)
    }

    /// Reads what [`Leaf::encode`] wrote.
    ///
    /// # Errors
    /// Names the first malformed or unsorted row.
    pub fn decode(bytes: &[u8]) -> Result<Self, ManifestError> {
        let leaf = Self {
            rows: decode_lines(bytes)?,
        };
        leaf.check()?;
        Ok(leaf)
    }

    fn check(&self) -> Result<(), ManifestError> {
        match self.rows.windows(2).find(|pair| pair[0].id >= pair[1].id) {
            Some(pair) => Err(ManifestError::Unsorted {
                id: pair[1].id.clone(),
            }),
            None => Ok(()),
        }
    }
}

impl Root {
    /// Stores the set through `put`, which stores bytes and returns their digest. Returns the digest of its root.
    ///
    /// # Errors
    /// The first error of `put`.
    pub fn write<E>(&self, mut put: impl FnMut(&[u8]) -> Result<Digest, E>) -> Result<Digest, E> {
        let mut blocks = Vec::new();
        for leaves in self
            .leaves
            .chunk_by(|a, b| a.shard / SHARDS_A_BLOCK == b.shard / SHARDS_A_BLOCK)
        {
            blocks.push(BlockRef {
                block: leaves[0].shard / SHARDS_A_BLOCK,
                digest: put(&encode_lines(leaves))?,
                leaves: leaves.len() as u32,
                rows: rows(leaves),
            });
        }
        put(&encode_lines(&blocks))
    }

    /// Reads a set that [`Root::write`] stored. `get` returns the bytes of a digest.
    ///
    /// # Errors
    /// Returns the first error of `get`, or an error if the bytes are not a manifest.
    pub fn read<E: From<ManifestError>>(
        root: &Digest,
        mut get: impl FnMut(&Digest) -> Result<Arc<[u8]>, E>,
    ) -> Result<Self, E> {
        let mut leaves = Vec::new();
        for block in Self::blocks(&get(root)?)? {
            leaves.extend(decode_lines::<LeafRef>(&get(&block.digest)?)?);
        }
        Ok(Self { leaves })
    }

    /// Returns references to leaves as bytes, one a line: the form of a block.
    pub fn encode_leaves(leaves: &[LeafRef]) -> Vec<u8> {
        encode_lines(leaves)
    }

    /// Reads references that [`Root::encode_leaves`] wrote.
    ///
    /// # Errors
    /// Returns an error if the bytes are not references.
    pub fn decode_leaves(bytes: &[u8]) -> Result<Vec<LeafRef>, ManifestError> {
        decode_lines(bytes)
    }

    /// Returns the blocks that the bytes of a root name, sorted by number.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a root.
    pub fn blocks(root: &[u8]) -> Result<Vec<BlockRef>, ManifestError> {
        decode_lines(root)
    }

    /// Returns the number of rows from the bytes of a root alone.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a root.
    pub fn count(root: &[u8]) -> Result<u64, ManifestError> {
        Ok(Self::blocks(root)?.iter().map(|block| block.rows).sum())
    }

    /// Returns the number of rows in all leaves.
    pub fn rows(&self) -> u64 {
        rows(&self.leaves)
    }
}

fn rows(leaves: &[LeafRef]) -> u64 {
    leaves.iter().map(|leaf| u64::from(leaf.rows)).sum()
}

fn encode_lines<T: Serialize>(items: &[T]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for item in items {
        // Strings, digests, integers and sorted maps always serialise.
        if serde_json::to_writer(&mut bytes, item).is_ok() {
            bytes.push(b'\n');
        }
    }
    bytes
}

fn decode_lines<T: for<'a> Deserialize<'a>>(bytes: &[u8]) -> Result<Vec<T>, ManifestError> {
    let lines = bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
    lines.map(|line| Ok(serde_json::from_slice(line)?)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(id: &str) -> Row {
        let blobs = BTreeMap::from([("image".to_owned(), Digest::from_content(id.as_bytes()))]);
        Row {
            id: id.to_owned(),
            blobs,
            facts: serde_json::json!({"sol": 1, "bytes": 20}),
        }
    }

    #[test]
    fn a_leaf_is_the_same_bytes_for_any_order_of_rows() {
        let one = Leaf::new(vec![row("b"), row("a"), row("c")]).unwrap();
        let two = Leaf::new(vec![row("c"), row("b"), row("a")]).unwrap();
        assert_eq!(one.encode(), two.encode());
        assert_eq!(Leaf::decode(&one.encode()).unwrap(), one);
    }

    #[test]
    fn a_repeated_id_is_refused_by_name() {
        let error = Leaf::new(vec![row("a"), row("b"), row("a")]).unwrap_err();
        assert!(error.to_string().contains("`a`"), "{error}");
    }

    /// A store in memory.
    #[derive(Default)]
    struct Blobs(BTreeMap<Digest, Arc<[u8]>>);

    impl Blobs {
        fn put(&mut self, bytes: &[u8]) -> Result<Digest, ManifestError> {
            let digest = Digest::from_content(bytes);
            self.0.insert(digest, Arc::from(bytes));
            Ok(digest)
        }

        fn read(&self, root: &Digest) -> Result<Root, ManifestError> {
            Root::read(root, |digest| Ok(Arc::clone(&self.0[digest])))
        }
    }

    fn root(shards: impl IntoIterator<Item = u32>) -> Root {
        let leaf = |shard: u32| LeafRef {
            shard,
            leaf: Digest::from_content(&shard.to_le_bytes()),
            rows: 3,
        };
        Root {
            leaves: shards.into_iter().map(leaf).collect(),
        }
    }

    #[test]
    fn an_empty_leaf_and_an_empty_set_survive() {
        assert_eq!(Leaf::decode(&Leaf::default().encode()).unwrap(), Leaf::default());
        let mut blobs = Blobs::default();
        let digest = Root::default().write(|bytes| blobs.put(bytes)).unwrap();
        assert_eq!(blobs.read(&digest).unwrap(), Root::default());
    }

    #[test]
    fn a_new_shard_writes_one_block_and_the_root() {
        let mut blobs = Blobs::default();
        let set = root(0..1000);
        let digest = set.write(|bytes| blobs.put(bytes)).unwrap();
        assert_eq!(blobs.read(&digest).unwrap(), set);
        assert_eq!(Root::count(&blobs.0[&digest]).unwrap(), 3000);
        let before = blobs.0.len();
        root(0..1001).write(|bytes| blobs.put(bytes)).unwrap();
        assert_eq!(blobs.0.len() - before, 2);
    }

    /// The extreme shards, and two leaves of one shard, which are in one block.
    #[test]
    fn shards_at_the_ends_of_their_range_survive() {
        let mut blobs = Blobs::default();
        let set = root([0, 0, 63, 64, u32::MAX]);
        let digest = set.write(|bytes| blobs.put(bytes)).unwrap();
        assert_eq!(blobs.read(&digest).unwrap(), set);
        assert_eq!(Root::blocks(&blobs.0[&digest]).unwrap().len(), 3);
    }
}

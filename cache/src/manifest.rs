//! Merkle manifests: a set of items as leaves of sorted rows, shard (sol) by shard.
//!
//! A root is a sorted list of (shard, digest of a leaf); a leaf is up to [`ROWS_A_LEAF`] rows sorted by id. Sets
//! of equal roots are equal, and equal leaves need not be read.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::Digest;

/// Most rows of one leaf: 4,000 rows of some hundred bytes stay under a megabyte.
pub const ROWS_A_LEAF: usize = 4_000;

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
    /// The sol; 0 where a set has none.
    pub shard: u32,
    /// Digest of the encoded leaf.
    pub leaf: Digest,
    /// Number of rows.
    pub rows: u32,
}

/// A manifest that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ManifestError {
    /// The bytes are no manifest.
    #[error("not a manifest: {0}")]
    Malformed(#[from] serde_json::Error),
    /// Rows are not sorted or an id occurs twice.
    #[error("row `{id}` is out of order or a repetition")]
    Unsorted {
        /// The row's id.
        id: String,
    },
}

impl Leaf {
    /// Sorts rows into a leaf; every id may occur once.
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
    /// Returns the canonical bytes, one leaf a line.
    pub fn encode(&self) -> Vec<u8> {
        encode_lines(&self.leaves)
    }

    /// Reads what [`Root::encode`] wrote.
    ///
    /// # Errors
    /// Bytes that are no root.
    pub fn decode(bytes: &[u8]) -> Result<Self, ManifestError> {
        Ok(Self {
            leaves: decode_lines(bytes)?,
        })
    }

    /// Returns the number of rows in all leaves.
    pub fn rows(&self) -> u64 {
        self.leaves.iter().map(|leaf| u64::from(leaf.rows)).sum()
    }
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
        let blobs = BTreeMap::from([("image".to_owned(), Digest::of(id.as_bytes()))]);
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

    #[test]
    fn an_empty_leaf_and_root_survive() {
        assert_eq!(Leaf::decode(&Leaf::default().encode()).unwrap(), Leaf::default());
        assert_eq!(Root::decode(&Root::default().encode()).unwrap(), Root::default());
    }
}

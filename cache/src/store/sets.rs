//! Sets of items, read from their manifests.

use super::{Store, StoreError};
use crate::{
    Digest,
    manifest::{Leaf, ManifestError, Root},
};

/// Why a set, or a leaf of one, cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum SetError {
    /// A blob of it cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A blob of the set is not a manifest.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
}

impl Store {
    /// Reads a set, without its leaves.
    ///
    /// # Errors
    /// A blob that is missing, damaged, or no manifest.
    pub fn set(&self, root: &Digest) -> Result<Root, SetError> {
        Root::read(root, |digest| Ok(self.get(digest)?))
    }

    /// Reads a leaf of a set.
    ///
    /// # Errors
    /// As [`Store::set`].
    pub fn leaf(&self, leaf: &Digest) -> Result<Leaf, SetError> {
        Ok(Leaf::decode(&self.get(leaf)?)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::{LeafRef, Row};

    fn row(id: &str) -> Row {
        Row {
            id: id.to_owned(),
            blobs: Default::default(),
            facts: serde_json::Value::Null,
        }
    }

    #[test]
    fn a_set_comes_back_and_what_is_missing_or_no_set_is_told_apart() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open(dir.path().join("store")).unwrap();
        let leaf = Leaf::new(vec![row("a"), row("b")]).unwrap();
        let leaf_ref = LeafRef {
            shard: 7,
            leaf: store.put(&leaf.encode()).unwrap(),
            rows: 2,
        };
        let set = Root {
            leaves: vec![leaf_ref],
        };
        let root = set.write(|bytes| store.put(bytes)).unwrap();
        assert_eq!(store.set(&root).unwrap(), set);
        assert_eq!(store.leaf(&set.leaves[0].leaf).unwrap(), leaf);
        let absent = Digest::from_content(b"nowhere");
        assert!(matches!(store.set(&absent), Err(SetError::Store(error)) if error.lost() == Some(absent)));
        let other = store.put(b"no set").unwrap();
        assert!(matches!(store.set(&other), Err(SetError::Manifest(_))));
        assert!(matches!(store.leaf(&other), Err(SetError::Manifest(_))));
    }
}

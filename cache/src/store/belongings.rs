//! What belongs to one result and to no other: what travels with its record.

use std::collections::BTreeSet;

use super::{Record, SetError, Store, read_digest_list};
use crate::{Action, Digest, manifest::Root};

/// The objects of one result, without those of the results that it was made from.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Belongings {
    /// Blobs, sorted: its action, what this reads of the store, its outputs, its list of needs and what that names, the
    /// set of its parts.
    pub blobs: Vec<Digest>,
    /// Keys of its parts and children, sorted.
    pub keys: Vec<Digest>,
}

impl Store {
    /// Returns everything that belongs to a committed result. With the belongings of its keys, and of all other results of a run, it is
    /// the closure of the run ([`Store::closure`]).
    ///
    /// # Errors
    /// Returns an error if a list of needs or a set of parts is missing or damaged.
    pub fn belongings(&self, record: &Record) -> Result<Belongings, SetError> {
        let mut blobs: BTreeSet<Digest> = record.objects().collect();
        blobs.insert(record.key);
        let mut keys: BTreeSet<Digest> = record.children.values().copied().collect();
        if let Some(list) = &record.needs {
            blobs.extend(read_digest_list(&self.get(list)?).unwrap_or_default());
        }
        if let Some(parts) = &record.parts {
            blobs.extend(self.blocks(parts)?);
            keys.extend(self.set(parts)?.leaves.iter().map(|part| part.leaf));
        }
        blobs.extend(self.stored_inputs(&record.key)?);
        Ok(Belongings {
            blobs: blobs.into_iter().collect(),
            keys: keys.into_iter().collect(),
        })
    }

    /// Returns the inputs of a key that are blobs of the store, and the blocks of those that are sets: the listing of a
    /// source is an output of nothing.
    fn stored_inputs(&self, key: &Digest) -> Result<Vec<Digest>, SetError> {
        let action = self.get(key).ok().and_then(|bytes| Action::decode(&bytes).ok());
        let inputs = action.into_iter().flat_map(|action| action.inputs.into_values());
        let mut stored = Vec::new();
        for input in inputs.filter(|input| self.contains(input)) {
            stored.push(input);
            if self.objects.is_set(&input)? {
                stored.extend(self.blocks(&input)?);
            }
        }
        Ok(stored)
    }

    /// Returns the blocks of a set.
    fn blocks(&self, root: &Digest) -> Result<Vec<Digest>, SetError> {
        let blocks = Root::blocks(&self.get(root)?)?;
        Ok(blocks.into_iter().map(|block| block.digest).collect())
    }
}

//! All objects of a store at one moment, in 24 bytes an object: 16 of its id, 8 of kind and length.

use super::{error::StoreError, objects::Objects, pack::Kind};
use crate::Digest;

/// Bytes of an id that are compared: two of a million ids agree in 16 bytes with a probability of 10^-27.
pub(super) const PREFIX: usize = 16;
const KIND_SHIFT: u32 = 56;
/// An object that was in the store when it was listed.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Item {
    id: [u8; PREFIX],
    /// Kind in the top byte, length below.
    kind_and_bytes: u64,
}

/// All objects of a store at one moment.
pub(super) struct Census(Vec<Item>);

/// Returns the bytes of an id that are compared.
pub(super) fn prefix(id: &Digest) -> [u8; PREFIX] {
    let mut bytes = [0; PREFIX];
    bytes.copy_from_slice(id.as_bytes().split_at(PREFIX).0);
    bytes
}

impl Item {
    fn new(kind: Kind, id: &Digest, bytes: u64) -> Self {
        Self {
            id: prefix(id),
            kind_and_bytes: u64::from(kind.code()) << KIND_SHIFT | bytes,
        }
    }

    fn kind_code(self) -> u8 {
        (self.kind_and_bytes >> KIND_SHIFT) as u8
    }

    fn bytes(self) -> u64 {
        self.kind_and_bytes & ((1 << KIND_SHIFT) - 1)
    }
}

impl Census {
    /// Lists all objects.
    pub(super) fn take(objects: &Objects) -> Result<Self, StoreError> {
        let mut items = Vec::new();
        objects
            .index
            .for_each(|row| items.push(Item::new(row.kind, &row.id, u64::from(row.len))))?;
        objects.for_each_loose(|digest, meta| items.push(Item::new(Kind::Blob, &digest, meta.bytes)))?;
        items.sort_unstable();
        items.dedup_by_key(|item| (item.id, item.kind_code()));
        Ok(Self(items))
    }

    /// Returns how many objects there are.
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns the number of an object.
    pub(super) fn find(&self, kind: Kind, id: &Digest) -> Option<usize> {
        let wanted = (prefix(id), kind.code());
        self.0
            .binary_search_by_key(&wanted, |item| (item.id, item.kind_code()))
            .ok()
    }

    /// Returns the length of an object, in bytes.
    pub(super) fn bytes(&self, number: usize) -> u64 {
        self.0.get(number).map_or(0, |item| item.bytes())
    }
}

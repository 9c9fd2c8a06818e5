//! Objects that are named and not in the store.

use crate::Digest;

/// As what an object is named.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// The record of a key that was asked for.
    Record,
    /// The action of a key.
    Action,
    /// What an action reads, unless it is a [`crate::FINGERPRINT`].
    Input,
    /// An output of a record.
    Output,
    /// The list of what a record needs.
    Needs,
    /// A blob in this list.
    Need,
    /// The set of the parts of a record.
    Parts,
    /// The record of a part.
    Part,
    /// The record of a child.
    Child,
    /// The root of a set, or a blob that was asked for.
    Root,
    /// A block of a set.
    Block,
    /// A leaf of a set.
    Leaf,
    /// A blob that a row of a leaf names.
    Row,
}

/// An object that is named and not in the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct MissingObject {
    /// The blob, or the key of the record.
    pub digest: Digest,
    /// As what it is named.
    pub role: Role,
    /// The key or the set that names it.
    pub named_by: Digest,
}

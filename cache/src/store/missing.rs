//! Objects that are named and not in the store.

use crate::Digest;

/// An object that is named and not in the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct MissingObject {
    /// The blob, or the key of the record.
    pub digest: Digest,
    /// As what it is named, for people: `output`, `record of a part`.
    pub role: &'static str,
    /// The key or the set that names it.
    pub named_by: Digest,
}

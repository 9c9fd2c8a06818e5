//! Content-addressed store of marf: digests, content hashes, manifests, records, blobs.
//!
//! Bytes only: this room knows no graph, no stage and no image.
//! Invariant: a byte string that leaves the store has the digest it was asked for by.

extern crate self as marf_cache;

mod content_hash;
mod digest;
pub mod manifest;
mod store;

pub use content_hash::{ContentHash, Visitor, digest_of, manifest_text};
pub use digest::{Digest, ParseDigestError};
pub use marf_cache_derive::ContentHash;
pub use store::{Conflict, Output, Record, RunMetadata, Store, StoreError, StoreStat};

#[doc(hidden)]
pub mod __private {
    pub use crate::content_hash::{ContentHash, Visitor};
}

//! Content-addressed store of marf: digests, content hashes, manifests, records, blobs.
//!
//! This crate knows bytes only: no graph, no stage, no image.
//! Invariant: the bytes that the store returns have the digest they were asked for by.

extern crate self as marf_cache;

mod action;
mod content_hash;
mod digest;
mod json;
pub mod manifest;
mod store;

pub use action::{ACTION_FORMAT, Action, ActionError, ChildVersion};
pub use content_hash::{ContentHash, Visitor, digest_of, manifest_text};
pub use digest::{Digest, ParseDigestError, Sha256};
pub use json::canonical_json;
pub use marf_cache_derive::ContentHash;
pub use store::{
    Belongings, Closure, Conflict, Fault, FsckOptions, FsckReport, GcPlan, GcReport, LostDocument,
    MigratedNode, Migration, Missing, Output, Record, Role, Roots, RunMetadata, SetError, StageStat, Store,
    StoreError, StoreStat, Upstream, digest_list, read_digest_list,
};

#[doc(hidden)]
pub mod __private {
    pub use crate::content_hash::{ContentHash, Visitor};
}

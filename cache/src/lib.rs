//! Content-addressed store of marf: digests, content hashes, manifests, records, blobs.
//!
//! This crate knows bytes only: no graph, no stage, no image.
//! Invariant: the bytes that the store returns have the digest they were asked for by.

mod action;
mod content_hash;
mod digest;
pub mod file;
mod json;
pub mod manifest;
mod store;

pub use action::{ACTION_FORMAT, Action, ActionError, ChildVersion, FINGERPRINT, LISTING};
pub use content_hash::{Bytes, ContentHash, ContentHasher, digest_of};
pub use digest::{Digest, ParseDigestError, Sha256, Sha256Reader};
pub use json::canonical_json;
pub use store::{
    Belongings, Closure, Conflict, Fault, FsckOptions, FsckReport, GcPlan, GcReport, LostDocument,
    MissingObject, Output, ReadShare, Record, Roots, RunMetadata, SetError, StageStat, Store, StoreError,
    StoreStat, Upstream, digest_list, read_digest_list,
};

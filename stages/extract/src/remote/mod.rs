//! Archives on servers: their listings, pins in marf.lock, downloads. Kinds of archives build on it.
//!
//! ```text
//! online:          catalog (listings of the server, cached) ─┐
//! locked, offline: marf.lock ────────────────────────────────┴─ shards ─ fetch what the store lacks ─ pins ─ marf.lock
//! ```
//! A shard's fingerprint holds names and the digests of the pinned bytes, never addresses. The same products from
//! another mirror are the same sol, and a changed pin is another. A product without a pin enters as such. The fetch
//! then returns the fingerprint with the new pins, which is the key of the result and which the next listing returns.
//!
//! A run with nothing new reads no pins and no pages. Summaries in the scratch folder hold their results, under the
//! state of each sol's file in marf.lock and the digest of the listing. The pins of each sol are also kept in the
//! store, so that a lost marf.lock is written again as it was.

mod archive;
pub(crate) mod catalog;
pub(crate) mod crawl;
mod fetch;
mod lock;
pub(crate) mod network;
mod online;
pub(crate) mod pages;
mod summary;

use marf_stage::{Cancel, Ctx, Listing, StageError};

pub(crate) use self::archive::{RemoteArchive, Request};
pub(crate) use self::lock::pins_in;
pub use self::lock::{PinnedProduct, UnreadableLock, pinned_products};
use crate::archive::check::Check;
use crate::archive::{ArchiveFiles, ShardFiles};

impl ArchiveFiles for RemoteArchive {
    fn list(&self, ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        self.listing(ctx)
    }

    fn files(&self, ctx: &Ctx<'_>, shard: u32) -> Result<ShardFiles, StageError> {
        fetch::sol(self, ctx, shard, self.sol(ctx, shard)?)
    }

    fn check(&self, cancel: &Cancel) -> Result<Vec<Check>, StageError> {
        self.ask_for_one_of_each(cancel)
    }
}

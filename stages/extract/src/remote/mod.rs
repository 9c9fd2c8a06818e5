//! Archives on servers: what they list, what is pinned in marf.lock, what is fetched. Kinds of archives build on it.
//!
//! ```text
//! online:          catalog (listings of the server, cached) ─┐
//! locked, offline: marf.lock ────────────────────────────────┴─ shards ─ fetch what the store lacks ─ pins ─ marf.lock
//! ```
//! A shard's fingerprint holds names, never addresses: the same products from another mirror are the same sol.

mod archive;
pub(crate) mod cache;
pub(crate) mod catalog;
pub(crate) mod crawl;
mod fetch;
mod lock;
pub(crate) mod network;

use marf_stage::{Ctx, Listing, Shard, StageError};

pub(crate) use self::archive::{RemoteArchive, Request};
use self::lock::SolPins;
use crate::archive::{ArchiveFile, ArchiveFiles};

impl ArchiveFiles for RemoteArchive {
    fn list(&self, ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        let sols = self.survey(ctx)?;
        let state = self.state();
        let none = SolPins::default();
        let pins = |sol: &u32| {
            state
                .pins
                .as_ref()
                .and_then(|pins| pins.sols.get(sol))
                .unwrap_or(&none)
        };
        let shards = sols.iter().map(|(sol, files)| Shard {
            shard: *sol,
            fingerprint: files.fingerprint(pins(sol)),
        });
        let files = sols
            .iter()
            .flat_map(|(sol, files)| files.files.keys().map(move |name| (sol, name)));
        let new = files
            .filter(|(sol, name)| !pins(sol).files.contains_key(*name))
            .count();
        Ok(Listing {
            shards: shards.collect(),
            note: (new > 0).then(|| format!("{new} files to fetch")),
            ..Listing::default()
        })
    }

    fn files(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Vec<ArchiveFile>, StageError> {
        let listed = self.state().sols.clone();
        let sols = match listed {
            Some(sols) => sols,
            None => self.survey(ctx)?,
        };
        let files = sols.get(&shard).ok_or_else(|| {
            StageError::new(format!("archive `{}` has no sol {shard} any more", self.name()))
                .hint("run again: it is listed anew")
        })?;
        fetch::sol(self, ctx, shard, files)
    }
}

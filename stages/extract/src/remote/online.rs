//! Compares a server's listing with the pins, sol by sol.

use marf_cache::{Digest, digest_of};
use marf_stage::{Ctx, Listing, Shard, StageError};

use super::catalog::{CatalogSource, SolListing};
use super::lock::{Change, Lock, OpenLock, SolPins};
use super::pages::Pages;
use super::summary::{Listed, Summaries, damaged, one_line};

/// Sols whose lost pins are written together, so that not all are in memory at once.
const RESTORED_AT_ONCE: usize = 32;

/// Compares a server's listing with the pins, sol by sol.
pub(super) struct Online<'a> {
    pub source: &'a dyn CatalogSource,
    /// Where pins are written.
    pub place: &'a Lock,
    /// Returns the pins of a sol that the store has.
    pub remembered: &'a dyn Fn(u32) -> Option<SolPins>,
    pub ctx: &'a Ctx<'a>,
    pub pages: &'a Pages,
    pub lock: &'a OpenLock,
    pub summaries: &'a Summaries<'a>,
    pub listing: Listing,
    pub unpinned: usize,
    /// Pins that the lock lacks and the store has.
    pub restored: Vec<Change>,
}

impl Online<'_> {
    /// Adds a sol, if the server has anything of it.
    pub fn add(&mut self, sol: u32, listing: &SolListing) -> Result<(), StageError> {
        let summary = match self.summaries.get(sol) {
            Ok(summary) => summary,
            Err(error) => {
                let fingerprint = damaged(&mut self.listing, sol, &error);
                self.push(sol, fingerprint, 0);
                return Ok(());
            }
        };
        let paths = match (listing, &summary) {
            (SolListing::Pinned, Some(summary)) => {
                self.push(sol, summary.fingerprint, 0);
                return Ok(());
            }
            (SolListing::Pinned, None) => return Ok(()),
            (SolListing::Pages(paths), _) => paths,
        };
        let digest = listing.digest(self.pages);
        let known = summary.as_ref().and_then(|summary| summary.listed);
        if let Some(known) = known.filter(|known| known.listing == digest) {
            self.push(sol, known.fingerprint, known.unpinned);
            return Ok(());
        }
        if summary.is_none() && self.summaries.is_empty(sol, &digest) {
            return Ok(());
        }
        let Some(files) = self.source.files(self.pages, sol, paths)? else {
            // Its pages are damaged: they are asked for again when it is brought.
            self.push(sol, digest_of(&("lost", digest)), 0);
            return Ok(());
        };
        let pins = match summary {
            Some(_) => self.lock.pins(sol)?,
            None => self.remembered(sol)?,
        };
        let is_pinned = pins.is_some();
        let pins = pins.unwrap_or_default();
        let files = files.with_history(&pins);
        if files.is_empty() {
            if !is_pinned {
                self.summaries.set_empty(sol, digest);
            }
            return Ok(());
        }
        let listed = Listed {
            listing: digest,
            fingerprint: files.fingerprint(&pins),
            unpinned: files.unpinned(&pins),
        };
        self.summaries.set_listed(sol, listed);
        self.push(sol, listed.fingerprint, listed.unpinned);
        Ok(())
    }

    /// Returns the pins of a sol that the lock lacks and the store has, and schedules writing them again.
    fn remembered(&mut self, sol: u32) -> Result<Option<SolPins>, StageError> {
        let Some(pins) = (self.remembered)(sol) else {
            return Ok(None);
        };
        self.restored.push(Change {
            sol,
            base: SolPins::default(),
            pins: pins.clone(),
        });
        if self.restored.len() >= RESTORED_AT_ONCE {
            self.restore()?;
        }
        Ok(Some(pins))
    }

    /// Writes the pins that were lost. Where they cannot be written, they are at the next run.
    ///
    /// # Errors
    /// The wish to stop.
    pub fn restore(&mut self) -> Result<(), StageError> {
        let restored = std::mem::take(&mut self.restored);
        if restored.is_empty() {
            return Ok(());
        }
        match self.place.write(self.ctx, restored) {
            Ok(_) => {}
            Err(StageError::Cancelled) => return Err(StageError::Cancelled),
            Err(error) => {
                let warning = format!("pins that the store has are not written: {}", one_line(&error));
                self.listing.warnings.push(warning);
            }
        }
        Ok(())
    }

    fn push(&mut self, sol: u32, fingerprint: Digest, unpinned: usize) {
        self.unpinned += unpinned;
        self.listing.shards.push(Shard {
            shard: sol,
            fingerprint,
        });
    }
}

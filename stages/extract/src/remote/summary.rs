//! Summaries of the pins of each sol, kept in the scratch folder. While the state of its file in marf.lock is
//! unchanged, the file is not read. Their loss costs only time.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_cache::{Digest, digest_of};
use marf_stage::{Listing, StageError};
use serde::{Deserialize, Serialize};

use super::catalog::SolFiles;
use super::lock::{OpenLock, SolPins};
use crate::files::{read_checked, write_checked};
use crate::stat::{FileState, now_ns};

/// Raised when a summary, or a fingerprint in it, has another form.
const FORM: u32 = 1;

/// Summary of the pins of a sol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Summary {
    /// State of its file when it was read. `None` if the pins do not come from a file of their own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    state: Option<FileState>,
    /// The request for which every listed file has come.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub complete: Option<String>,
    /// The fingerprint that the pins alone give.
    pub fingerprint: Digest,
    /// What the pins and a listing give.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub listed: Option<Listed>,
}

/// What the pins of a sol and its listing give.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Listed {
    /// Digest of the listing.
    pub listing: Digest,
    /// The fingerprint.
    pub fingerprint: Digest,
    /// Number of files that are wanted and not pinned.
    pub unpinned: usize,
}

#[derive(Default, PartialEq, Serialize, Deserialize)]
struct Table {
    sols: BTreeMap<u32, Summary>,
    /// Sols that have neither pins nor products, with the digest of the listing that says so.
    empty: BTreeMap<u32, Digest>,
}

/// Summaries of an archive, made when they are asked for.
pub(super) struct Summaries<'a> {
    lock: &'a OpenLock,
    path: PathBuf,
    before: Table,
    now: RefCell<Table>,
    /// When the first file was read.
    began_ns: i64,
}

impl<'a> Summaries<'a> {
    /// Opens the summaries of the archive that `name` identifies.
    pub fn open(scratch: &Path, name: &str, lock: &'a OpenLock) -> Self {
        let key = Digest::from_content(format!("summaries {FORM}\n{name}").as_bytes());
        let path = scratch.join("pins").join(key.to_string());
        let before = read_checked(&path).and_then(|bytes| serde_json::from_slice(&bytes).ok());
        Self {
            lock,
            path,
            before: before.unwrap_or_default(),
            now: RefCell::default(),
            began_ns: now_ns(),
        }
    }

    /// Returns the summary of a sol, if it has pins. Its file is read only if it changed.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn get(&self, sol: u32) -> Result<Option<Summary>, StageError> {
        if let Some(summary) = self.now.borrow().sols.get(&sol) {
            return Ok(Some(summary.clone()));
        }
        let state = self.lock.state(sol);
        let known = self
            .before
            .sols
            .get(&sol)
            .filter(|known| state.is_some() && known.state == state);
        let summary = match known {
            Some(known) => Some(known.clone()),
            None => self.lock.pins(sol)?.map(|pins| Summary {
                state,
                ..summary(&pins)
            }),
        };
        let kept = summary.clone().map(|summary| (sol, summary));
        self.now.borrow_mut().sols.extend(kept);
        Ok(summary)
    }

    /// Whether a listing is known to have nothing of a sol that has no pins.
    pub fn is_empty(&self, sol: u32, listing: &Digest) -> bool {
        let empty = self.before.empty.get(&sol) == Some(listing);
        if empty {
            self.set_empty(sol, *listing);
        }
        empty
    }

    /// Keeps that a listing has nothing of a sol that has no pins.
    pub fn set_empty(&self, sol: u32, listing: Digest) {
        self.now.borrow_mut().empty.insert(sol, listing);
    }

    /// Keeps the combined result of a sol's pins and its listing.
    pub fn set_listed(&self, sol: u32, listed: Listed) {
        if let Some(summary) = self.now.borrow_mut().sols.get_mut(&sol) {
            summary.listed = Some(listed);
        }
    }

    /// Writes the summaries of files that had rested when they were read, for the next run.
    pub fn save(self) {
        let mut table = self.now.into_inner();
        table
            .sols
            .retain(|_, summary| summary.state.is_some_and(|state| state.rested(self.began_ns)));
        // Summaries of sols outside this pipeline's request stay.
        for (sol, summary) in &self.before.sols {
            table.sols.entry(*sol).or_insert_with(|| summary.clone());
        }
        if table != self.before
            && let Ok(bytes) = serde_json::to_vec(&table)
        {
            write_checked(&self.path, bytes);
        }
    }
}

/// Returns the summary of pins that were just read.
fn summary(pins: &SolPins) -> Summary {
    Summary {
        state: None,
        complete: pins.complete.clone(),
        fingerprint: SolFiles::from_pins(pins).fingerprint(pins),
        listed: None,
    }
}

/// Warns of unreadable pins and returns a fingerprint that no result has, so that the sol fails when it is fetched.
pub(super) fn damaged(listing: &mut Listing, sol: u32, error: &StageError) -> Digest {
    listing.warnings.push(one_line(error));
    digest_of(&("damaged", sol))
}

/// Returns an error in one line, with its cause.
pub(super) fn one_line(error: &StageError) -> String {
    match error {
        StageError::Failed {
            message,
            cause: Some(cause),
            ..
        } => format!("{message}: {cause}"),
        other => other.to_string(),
    }
}

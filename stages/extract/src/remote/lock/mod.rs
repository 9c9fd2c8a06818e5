//! marf.lock: the files of each archive on servers, to the byte. A folder next to pipeline.toml:
//!
//! ```text
//! marf.lock/README                     description, and the file that a writer locks
//! marf.lock/jezero/archive.toml        what the pipeline requests from the archive
//! marf.lock/jezero/sol-00042.toml      the products of one sol, one a line
//! ```
//! Users keep it under version control. Writing a sol replaces its own file atomically and touches no other. Changes
//! that another process made to the same sol meanwhile are merged product by product. If two pipelines of one folder
//! request different things from archives of one name, each has a folder of its own.
//!
//! ```text
//! folder.rs   finding, reading and writing the files
//! text.rs     a sol as text
//! merge.rs    two changes of one sol
//! ```

mod all;
mod folder;
mod merge;
mod text;

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{Digest, Sha256};

pub(crate) use self::all::pins_in;
pub use self::all::{PinnedProduct, UnreadableLock, pinned_products};
pub(crate) use self::folder::{Change, Lock, OpenLock};
pub(crate) use self::text::{read as read_sol, write as write_sol};
use crate::net::Validators;

/// Replaces the address of bytes that came with the page that listed them (the record of a feed).
pub(crate) const WITH_LISTING: &str = "with the listing";

/// The pins of one sol.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct SolPins {
    /// Files that were fetched, by name.
    pub files: BTreeMap<String, Pin>,
    /// Files that were not wanted, by name, and why.
    pub left_out: BTreeMap<String, String>,
    /// Files that were listed and could not be fetched, by name: the last status.
    pub gone: BTreeMap<String, u16>,
    /// The request for which every listed file has come. `None` while a file is missing.
    pub complete: Option<String>,
}

/// A file as it was fetched.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Pin {
    /// Length, bytes.
    pub bytes: u64,
    /// Digest of the bytes.
    pub blake3: Digest,
    /// The digest by which others know the bytes.
    pub sha256: Sha256,
    /// The address that gave it.
    pub url: String,
    /// The time, as `YYYY-MM-DDTHH:MM:SSZ`.
    pub fetched: String,
    /// What the server says of this state of the file.
    pub validators: Validators,
    /// When the listing said it was last changed.
    pub listed: Option<String>,
    /// Other bytes that the archive gave under the same name later: kept, not used.
    pub others: BTreeSet<Digest>,
}

/// A place in a text that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct BadLine {
    /// The line, from 1 on.
    pub line: usize,
    /// What is wrong with it.
    pub cause: String,
}

/// Returns the line of a byte of a text, from 1 on.
fn line_of(text: &str, byte: usize) -> usize {
    text.bytes().take(byte).filter(|byte| *byte == b'\n').count() + 1
}

#[cfg(test)]
mod tests;

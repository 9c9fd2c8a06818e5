//! The version of the store's form, in its file `format`: a line with the number, and a line with the blake3 of the first,
//! so that a flipped bit is not taken for a later form.

use std::path::Path;

use super::{error::StoreError, files::Files};
use crate::Digest;

/// Version of the form of a store.
pub(super) const FORMAT: u32 = 2;

/// What a folder holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Found {
    /// No store.
    Nothing,
    /// A store of this form.
    Current,
    /// A store of 0.1.0.
    Old,
    /// A store whose file `format` is damaged.
    Unclear,
    /// A store of a later form.
    Newer(u32),
}

/// Returns the bytes of the file `format`.
pub(super) fn text() -> String {
    let line = format!("marf store {FORMAT}\n");
    let digest = Digest::of(line.as_bytes());
    format!("{line}{digest}\n")
}

/// Tells what a folder holds.
pub(super) fn find(files: &Files, root: &Path) -> Result<Found, StoreError> {
    if let Some(bytes) = files.read(&root.join("format"))? {
        return Ok(parse(&bytes));
    }
    let names = files.names(root)?;
    let has = |name: &str| names.iter().any(|found| found == name);
    // 0.1.0 made its index at the first commit of a record, so blobs may lie there without one.
    let packs = files.names(&root.join("packs"))?;
    Ok(match packs.iter().any(|name| name.ends_with(".idx")) {
        _ if has("index.redb") => Found::Old,
        _ if has("index.sqlite") => Found::Unclear,
        true => Found::Old,
        false => Found::Nothing,
    })
}

fn parse(bytes: &[u8]) -> Found {
    let parsed = std::str::from_utf8(bytes).ok().and_then(|text| {
        let (line, rest) = text.split_at_checked(text.find('\n')? + 1)?;
        let number: u32 = line.trim_end().strip_prefix("marf store ")?.parse().ok()?;
        let is_sealed = rest.is_empty() || rest.trim_end() == Digest::of(line.as_bytes()).to_string();
        Some((number, is_sealed))
    });
    match parsed {
        Some((FORMAT, _)) => Found::Current,
        Some((newer, true)) if newer > FORMAT => Found::Newer(newer),
        _ => Found::Unclear,
    }
}

/// Refuses a folder whose store this program does not read.
pub(super) fn check(root: &Path, found: Found) -> Result<(), StoreError> {
    let path = root.to_owned();
    match found {
        Found::Old => Err(StoreError::Older { path }),
        Found::Newer(found) => Err(StoreError::Newer {
            path,
            found,
            known: FORMAT,
        }),
        Found::Nothing | Found::Current | Found::Unclear => Ok(()),
    }
}

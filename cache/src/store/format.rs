//! The version of the store's form, in its file `format`: a line with the number, and a line with the blake3 of the first,
//! so that a flipped bit is not taken for a later form.

use std::path::Path;

use super::{error::StoreError, files::Files};
use crate::Digest;

/// Version of the form of a store.
pub(super) const FORMAT: u32 = 2;

/// The form of the store in a folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum StoreForm {
    /// No store.
    Nothing,
    /// A store of this form.
    Current,
    /// A store whose file `format` is damaged.
    Unclear,
    /// A store of a later form.
    Newer(u32),
}

/// Returns the bytes of the file `format`.
pub(super) fn text() -> String {
    let line = format!("marf store {FORMAT}\n");
    let digest = Digest::from_content(line.as_bytes());
    format!("{line}{digest}\n")
}

/// Returns the form of the store in a folder.
pub(super) fn find(files: &Files, root: &Path) -> Result<StoreForm, StoreError> {
    if let Some(bytes) = files.read(&root.join("format"))? {
        return Ok(parse(&bytes));
    }
    let has_index = files.meta(&root.join("index.sqlite")).is_some();
    Ok(if has_index {
        StoreForm::Unclear
    } else {
        StoreForm::Nothing
    })
}

fn parse(bytes: &[u8]) -> StoreForm {
    let parsed = std::str::from_utf8(bytes).ok().and_then(|text| {
        let (line, rest) = text.split_at_checked(text.find('\n')? + 1)?;
        let number: u32 = line.trim_end().strip_prefix("marf store ")?.parse().ok()?;
        let is_sealed =
            rest.is_empty() || rest.trim_end() == Digest::from_content(line.as_bytes()).to_string();
        Some((number, is_sealed))
    });
    match parsed {
        Some((FORMAT, _)) => StoreForm::Current,
        Some((newer, true)) if newer > FORMAT => StoreForm::Newer(newer),
        _ => StoreForm::Unclear,
    }
}

/// Refuses a folder whose store this program does not read.
pub(super) fn check(root: &Path, found: StoreForm) -> Result<(), StoreError> {
    match found {
        StoreForm::Newer(found) => Err(StoreError::Newer {
            path: root.to_owned(),
            found,
            known: FORMAT,
        }),
        StoreForm::Nothing | StoreForm::Current | StoreForm::Unclear => Ok(()),
    }
}

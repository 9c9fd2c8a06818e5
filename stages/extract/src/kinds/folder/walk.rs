//! Every file of a folder, by name.

use std::path::{MAIN_SEPARATOR, Path};

use marf_stage::{Ctx, StageError};
use rayon::prelude::*;
use walkdir::{DirEntry, WalkDir};

use crate::archive::is_system_name;
use crate::stat::FileState;

/// Deepest level of files that are read.
pub(super) const MAX_DEPTH: usize = 32;
/// Name of the store next to a pipeline.
const STORE: &str = ".marf";
/// Number of files after which the wish to stop is looked at.
const CHECK_EVERY: usize = 1_024;

/// A file of a folder.
#[derive(Debug)]
pub(super) struct WalkedFile {
    /// Name below the folder, with `/`.
    pub name: String,
    /// Its state, or why it is not read.
    pub state: Result<FileState, String>,
}

/// Returns the files of a folder, sorted by name. Hidden files and folders, and folders that are too deep, are named and not entered, unless systems are known to leave
/// them next to photos. Links are followed but not in circles.
///
/// # Errors
/// The wish to stop.
pub(super) fn walk(ctx: &Ctx<'_>, root: &Path, depth: usize) -> Result<Vec<WalkedFile>, StageError> {
    let walked = WalkDir::new(root).follow_links(true).max_depth(depth);
    let mut entries = walked.into_iter();
    let mut found: Vec<(String, Option<String>)> = Vec::new();
    while let Some(entry) = entries.next() {
        if found.len().is_multiple_of(CHECK_EVERY) {
            ctx.check()?;
        }
        let closed = entry.as_ref().ok().and_then(|entry| closed(entry, depth));
        if closed.is_some() && entry.as_ref().is_ok_and(|entry| entry.file_type().is_dir()) {
            entries.skip_current_dir();
        }
        found.extend(match (closed, entry) {
            (Some(Closed::Unnamed), _) => None,
            (Some(Closed::Named(reason)), Ok(entry)) => Some((relative(root, entry.path()).0, Some(reason))),
            (_, entry) => entry_of(root, entry),
        });
    }
    found.sort_unstable();
    found.dedup_by(|a, b| a.0 == b.0); // only names that are no UTF-8 can collide
    let file = |(name, problem): (String, Option<String>)| {
        ctx.check()?;
        let state = problem.map_or_else(|| state_of(&root.join(&name)), Err);
        Ok(WalkedFile { name, state })
    };
    match ctx.threads {
        0 | 1 => found.into_iter().map(file).collect(),
        _ => found.into_par_iter().map(file).collect(),
    }
}

/// A file that is not read, or a folder that is not entered.
enum Closed {
    /// It is named, with the reason.
    Named(String),
    /// The store of this program, and folders where the user wants none.
    Unnamed,
}

/// Returns why an entry is not looked at. `None` if it is.
fn closed(entry: &DirEntry, depth: usize) -> Option<Closed> {
    let name = entry.file_name();
    let is_folder = entry.file_type().is_dir();
    if entry.depth() == 0 {
        return None;
    }
    if name == STORE || (is_folder && depth < MAX_DEPTH && entry.depth() == depth) {
        return Some(Closed::Unnamed);
    }
    let is_hidden = name.as_encoded_bytes().starts_with(b".") && !name.to_str().is_some_and(is_system_name);
    let reason = match (is_hidden, is_folder) {
        (true, false) => "a hidden file".to_owned(),
        (true, true) => "a hidden folder, in which nothing is read".to_owned(),
        (false, true) if entry.depth() == depth => format!(
            "a folder in which nothing is read: at most {} are entered within each other",
            MAX_DEPTH - 1
        ),
        (false, _) => return None,
    };
    Some(Closed::Named(reason))
}

fn state_of(path: &Path) -> Result<FileState, String> {
    let meta = std::fs::metadata(path).map_err(|error| format!("cannot be read: {}", error.kind()))?;
    if !meta.is_file() {
        return Err(NO_FILE.to_owned());
    }
    Ok(FileState::from_metadata(&meta))
}

const NO_FILE: &str = "not a plain file";

/// Returns the name of an entry that is not a folder, and the reason why it is not read, if any.
fn entry_of(root: &Path, entry: walkdir::Result<DirEntry>) -> Option<(String, Option<String>)> {
    match entry {
        Ok(entry) if entry.file_type().is_dir() => None,
        Ok(entry) => {
            let (name, whole) = relative(root, entry.path());
            let problem = if !entry.file_type().is_file() {
                Some(NO_FILE)
            } else {
                (!whole).then_some("its name is not UTF-8")
            };
            Some((name, problem.map(str::to_owned)))
        }
        Err(error) => {
            let (name, _) = relative(root, error.path()?);
            let reason = match (error.loop_ancestor(), error.io_error()) {
                (Some(_), _) => "a link that leads back to a folder above it".to_owned(),
                (_, Some(io)) => format!("cannot be read: {}", io.kind()),
                _ => "cannot be read".to_owned(),
            };
            Some((name, Some(reason)))
        }
    }
}

/// Returns the name below the folder with `/`, and whether it is UTF-8.
fn relative(root: &Path, path: &Path) -> (String, bool) {
    let below = path.strip_prefix(root).unwrap_or(path);
    match below.to_str() {
        Some(name) if MAIN_SEPARATOR == '/' => (name.to_owned(), true),
        whole => {
            let parts: Vec<_> = below.iter().map(|part| part.to_string_lossy()).collect();
            (parts.join("/"), whole.is_some())
        }
    }
}

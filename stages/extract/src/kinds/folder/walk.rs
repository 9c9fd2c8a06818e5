//! Every file of a folder, by name.

use std::collections::BTreeMap;
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

/// The files of a folder, sorted by name. All names share one text, since a folder may hold millions.
#[derive(Debug, Default)]
pub(super) struct Names {
    text: String,
    spans: Vec<Span>,
}

#[derive(Debug, Clone, Copy)]
struct Span {
    start: u64,
    bytes: u32,
}

/// A folder that was walked.
#[derive(Debug, Default)]
pub(super) struct Walk {
    /// Names below the folder, with `/`, sorted.
    pub names: Names,
    /// Of each file its state, or why it is not read.
    pub files: Vec<Result<FileState, String>>,
}

impl Names {
    /// Returns the number of files.
    pub fn len(&self) -> usize {
        self.spans.len()
    }

    /// Returns the name of a file, empty beyond the last.
    pub fn get(&self, index: usize) -> &str {
        self.spans.get(index).map_or("", |span| self.at(span))
    }

    /// Whether there is a file of this name. The names must be sorted.
    pub fn contains(&self, name: &str) -> bool {
        self.spans
            .binary_search_by(|span| self.at(span).cmp(name))
            .is_ok()
    }

    fn at(&self, span: &Span) -> &str {
        let start = span.start as usize;
        self.text
            .get(start..start + span.bytes as usize)
            .unwrap_or_default()
    }

    fn push(&mut self, name: &str) {
        self.spans.push(Span {
            start: self.text.len() as u64,
            bytes: name.len() as u32,
        });
        self.text.push_str(name);
    }
}

/// Walks a folder. Hidden files and folders, and folders that are too deep, are named and not entered, unless systems are known to leave
/// them next to photos. Links are followed but not in circles.
///
/// # Errors
/// The wish to stop.
pub(super) fn walk(ctx: &Ctx<'_>, root: &Path, depth: usize) -> Result<Walk, StageError> {
    let walked = WalkDir::new(root).follow_links(true).max_depth(depth);
    let mut entries = walked.into_iter();
    let mut names = Names::default();
    // Few have one.
    let mut problems: BTreeMap<usize, String> = BTreeMap::new();
    while let Some(entry) = entries.next() {
        if names.len().is_multiple_of(CHECK_EVERY) {
            ctx.check()?;
        }
        let closed = entry.as_ref().ok().and_then(|entry| closed(entry, depth));
        if closed.is_some() && entry.as_ref().is_ok_and(|entry| entry.file_type().is_dir()) {
            entries.skip_current_dir();
        }
        let found = match (closed, entry) {
            (Some(Closed::Unnamed), _) => None,
            (Some(Closed::Named(reason)), Ok(entry)) => Some((relative(root, entry.path()).0, Some(reason))),
            (_, entry) => entry_of(root, entry),
        };
        if let Some((name, problem)) = found {
            problems.extend(problem.map(|problem| (names.len(), problem)));
            names.push(&name);
        }
    }
    let mut order: Vec<usize> = (0..names.len()).collect();
    let key = |index: usize| (names.get(index), problems.get(&index));
    order.sort_unstable_by(|a, b| key(*a).cmp(&key(*b)));
    order.dedup_by(|a, b| names.get(*a) == names.get(*b)); // only names that are no UTF-8 can collide
    let state = |index: &usize| -> Result<Result<FileState, String>, StageError> {
        if index.is_multiple_of(CHECK_EVERY) {
            ctx.check()?;
        }
        Ok(match problems.get(index) {
            Some(problem) => Err(problem.clone()),
            None => state_of(&root.join(names.get(*index))),
        })
    };
    let files = match ctx.threads {
        0 | 1 => order.iter().map(state).collect::<Result<_, _>>()?,
        _ => order.par_iter().map(state).collect::<Result<_, _>>()?,
    };
    names.spans = order.iter().map(|index| names.spans[*index]).collect();
    Ok(Walk { names, files })
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

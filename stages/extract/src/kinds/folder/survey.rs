//! The files of a folder: known from the table or read, and sorted into sols.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use marf_cache::Digest;
use marf_pds::{ProductName, join_key};
use marf_stage::{Ctx, Files, Keep, StageError};
use rayon::prelude::*;

use super::companions::{is_camera_file, is_mask};
use super::table::{self, Entry, EntryKind, Reader};
use super::walk::{Names, Walk, walk};
use crate::archive::{ArchiveFile, Known, LocalFile, ReadError, extension, stem};
use crate::stat::{FileState, now_ns};

/// Whether files are read though nothing says that they changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reading {
    /// Only those that are new or may have changed.
    Changed,
    /// All.
    All,
}

/// A folder, and how it is read.
#[derive(Debug, Clone)]
pub(super) struct Source {
    /// The folder.
    pub root: PathBuf,
    /// Deepest folder in it that is entered, from 1.
    pub depth: usize,
    /// Which files are read.
    pub reading: Reading,
    /// How the store keeps the bytes of photos.
    pub keep: Keep,
    /// Largest file that is read, bytes.
    pub limit_bytes: u64,
}

/// The files of a folder. One takes some 60 bytes and its name.
pub(super) struct Survey {
    names: Names,
    entries: Vec<Entry>,
    /// Why files cannot be read.
    reasons: Vec<String>,
    /// Files by sol, in the order of their names.
    pub shards: BTreeMap<u32, Vec<u32>>,
    /// Files of other programs, in the order of their names.
    pub companions: Vec<u32>,
}

impl Survey {
    /// Finds every file, reads those that are new or may have changed, and sorts them into shards and companions.
    ///
    /// # Errors
    /// The wish to stop.
    pub fn new(ctx: &Ctx<'_>, source: &Source) -> Result<Self, StageError> {
        Self::begun_at(now_ns(), ctx, source)
    }

    /// As [`Survey::new`], begun at a time. Files that were written shortly before are read again by the next survey.
    ///
    /// # Errors
    /// The wish to stop.
    pub fn begun_at(began_ns: i64, ctx: &Ctx<'_>, source: &Source) -> Result<Self, StageError> {
        let Walk { names, mut files } = walk(ctx, &source.root, source.depth)?;
        let limit_bytes = source.limit_bytes;
        for file in &mut files {
            if file.as_ref().is_ok_and(|state| state.size > limit_bytes) {
                *file = Err(ReadError::TooLarge { limit_bytes }.to_string());
            }
        }
        let table = table::path(ctx.scratch, &source.root, source.depth);
        let mut known = match (&table, source.reading) {
            (Some(table), Reading::Changed) => Reader::open(table),
            _ => Reader::default(),
        };
        let mut entries: Vec<Option<Entry>> = (files.iter().enumerate())
            .map(|(index, file)| known.find(names.get(index), file.as_ref().ok()?))
            .collect();
        let (known, hits) = (known.count(), entries.iter().flatten().count());
        let reasons = read_rest(ctx, source, &names, &files, &mut entries)?;
        let entries: Vec<Entry> = entries.into_iter().flatten().collect();
        let kept = files
            .iter()
            .zip(&entries)
            .filter(|(state, entry)| table::is_kept(state, entry, began_ns));
        if let Some(table) = table
            && (known, hits) != (hits, kept.count())
        {
            table::write(&table, &names, &files, &entries, began_ns);
        }
        let mut survey = Self {
            names,
            entries,
            reasons,
            shards: BTreeMap::new(),
            companions: Vec::new(),
        };
        survey.sort();
        Ok(survey)
    }

    /// Whether a file may be a photo.
    pub fn is_photo(&self, index: u32) -> bool {
        self.entry(index).is_some_and(Entry::is_photo)
    }

    /// Returns a file by its number.
    pub fn file(&self, source: &Source, index: u32) -> ArchiveFile {
        let name = self.names.get(index as usize);
        let known: Option<Known> = self.entry(index).and_then(|entry| entry.known(name));
        match known {
            Some(known) => {
                let file = LocalFile {
                    path: source.root.join(name),
                    keep: source.keep,
                    limit_bytes: source.limit_bytes,
                };
                ArchiveFile::on_disk(name.to_owned(), file, known)
            }
            None => ArchiveFile::unreadable(name.to_owned(), self.reason(index)),
        }
    }

    /// Returns names and digests of files.
    pub fn digests(&self, files: &[u32]) -> Files {
        let named = |index: &u32| {
            Some((
                self.names.get(*index as usize).to_owned(),
                self.entry(*index)?.digest,
            ))
        };
        Files(files.iter().filter_map(named).collect())
    }

    fn entry(&self, index: u32) -> Option<&Entry> {
        self.entries.get(index as usize)
    }

    fn reason(&self, index: u32) -> String {
        match self.entry(index).map(|entry| entry.kind) {
            Some(EntryKind::Unreadable(reason)) => {
                self.reasons.get(reason as usize).cloned().unwrap_or_default()
            }
            _ => String::new(),
        }
    }

    /// Sorts files into sols. A file without a sol in its name goes with the label or photo of its product.
    fn sort(&mut self) {
        let all = 0..self.entries.len() as u32;
        let (companions, files): (Vec<u32>, Vec<u32>) = all.partition(|index| self.is_companion(*index));
        let sol = |index: &u32| self.entry(*index).and_then(|entry| entry.sol);
        let lacking = files.iter().filter(|index| sol(index).is_none());
        let wanted: BTreeSet<String> = lacking.map(|index| self.product_key(*index)).collect();
        let mut sols: BTreeMap<String, u32> = BTreeMap::new();
        if !wanted.is_empty() {
            for (index, sol) in files.iter().filter_map(|index| Some((index, sol(index)?))) {
                let key = self.product_key(*index);
                if wanted.contains(&key) {
                    sols.entry(key).or_insert(sol);
                }
            }
        }
        let mut shards: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for index in &files {
            let sol = sol(index).or_else(|| sols.get(&self.product_key(*index)).copied());
            shards.entry(sol.unwrap_or(0)).or_default().push(*index);
        }
        (self.shards, self.companions) = (shards, companions);
    }

    fn is_companion(&self, index: u32) -> bool {
        let path = self.names.get(index as usize);
        let entry = self.entry(index);
        let readable = entry.is_some_and(|entry| !matches!(entry.kind, EntryKind::Unreadable(_)));
        let is_picture = entry.is_some_and(|entry| entry.kind == EntryKind::Photo);
        readable && (is_camera_file(path) || (is_picture && is_mask(path, &|name| self.names.contains(name))))
    }

    fn product_key(&self, index: u32) -> String {
        // `x.img.xml` and the like label `x.img`.
        let inner = stem(self.names.get(index as usize));
        let doubled = ["img", "png", "jpg"].contains(&extension(inner).as_str());
        join_key(if doubled { stem(inner) } else { inner })
    }
}

/// Reads the files without an entry and returns the reasons of those that cannot be read.
fn read_rest(
    ctx: &Ctx<'_>,
    source: &Source,
    names: &Names,
    files: &[Result<FileState, String>],
    entries: &mut [Option<Entry>],
) -> Result<Vec<String>, StageError> {
    let rest: Vec<usize> = (0..entries.len())
        .filter(|index| entries[*index].is_none())
        .collect();
    let read = |index: &usize| -> Result<Result<Entry, String>, StageError> {
        ctx.check()?;
        Ok(match &files[*index] {
            Ok(_) => read_one(source, names.get(*index)),
            Err(reason) => Err(reason.clone()),
        })
    };
    let outcomes: Vec<Result<Entry, String>> = match ctx.threads {
        0 | 1 => rest.iter().map(read).collect::<Result<_, _>>()?,
        _ => rest.par_iter().map(read).collect::<Result<_, _>>()?,
    };
    let mut reasons = Vec::new();
    for (index, outcome) in rest.into_iter().zip(outcomes) {
        let entry = outcome.unwrap_or_else(|reason| {
            let sol = ProductName::read(stem(names.get(index))).and_then(|product| product.sol);
            let entry = Entry {
                kind: EntryKind::Unreadable(reasons.len() as u32),
                digest: Digest::from_content(reason.as_bytes()),
                sol,
            };
            reasons.push(reason);
            entry
        });
        entries[index] = Some(entry);
    }
    Ok(reasons)
}

fn read_one(source: &Source, name: &str) -> Result<Entry, String> {
    let known = Known::read(name, &source.root.join(name), source.limit_bytes);
    let known = known.map_err(|error| error.to_string())?;
    Entry::from_known(&known).ok_or_else(|| "cannot be read".to_owned())
}

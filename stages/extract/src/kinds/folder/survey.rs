//! The files of a folder: known from the table or read, and sorted into sols.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use marf_cache::Digest;
use marf_pds::{ProductName, join_key};
use marf_stage::{Ctx, Files, Keep, OriginKind, StageError};
use rayon::prelude::*;

use super::companions::{is_camera_file, is_mask};
use super::table::Table;
use super::walk::{WalkedFile, walk};
use crate::archive::{ArchiveFile, Known, LocalFile, ReadError, extension, stem};
use crate::stat::now_ns;

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

/// The files of a folder.
pub(super) struct Survey {
    /// Their names, sorted, and what is known of them.
    files: Vec<(String, Known)>,
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
        let mut files = walk(ctx, &source.root, source.depth)?;
        let limit_bytes = source.limit_bytes;
        for file in &mut files {
            if file.state.as_ref().is_ok_and(|state| state.size > limit_bytes) {
                file.state = Err(ReadError::TooLarge { limit_bytes }.to_string());
            }
        }
        let path = Table::path(ctx.scratch, &source.root, source.depth);
        let before = path.as_deref().map(Table::open).unwrap_or_default();
        let known = known(ctx, source, &files, &before)?;
        let table = Table::new(&files, &known, began_ns);
        if let Some(path) = path
            && table != before
        {
            table.write(&path);
        }
        let names = files.into_iter().map(|file| file.name);
        let mut survey = Self {
            files: names.zip(known).collect(),
            shards: BTreeMap::new(),
            companions: Vec::new(),
        };
        survey.sort();
        Ok(survey)
    }

    /// Whether a file may be a photo.
    pub fn is_photo(&self, index: u32) -> bool {
        matches!(self.known(index).kind, OriginKind::Photo | OriginKind::Raw)
    }

    /// Returns a file by its number.
    pub fn file(&self, source: &Source, index: u32) -> ArchiveFile {
        let (name, known) = &self.files[index as usize];
        let file = LocalFile {
            path: source.root.join(name),
            keep: source.keep,
            limit_bytes: source.limit_bytes,
        };
        ArchiveFile::on_disk(name.clone(), file, known.clone())
    }

    /// Returns names and digests of files.
    pub fn digests(&self, files: &[u32]) -> Files {
        let named = |index: &u32| (self.name(*index).to_owned(), self.known(*index).digest);
        Files(files.iter().map(named).collect())
    }

    fn name(&self, index: u32) -> &str {
        &self.files[index as usize].0
    }

    fn known(&self, index: u32) -> &Known {
        &self.files[index as usize].1
    }

    fn exists(&self, name: &str) -> bool {
        self.files
            .binary_search_by(|(known, _)| known.as_str().cmp(name))
            .is_ok()
    }

    /// Sorts files into sols. A file without a sol in its name goes with the label or photo of its product.
    fn sort(&mut self) {
        let all = 0..self.files.len() as u32;
        let (companions, files): (Vec<u32>, Vec<u32>) = all.partition(|index| self.is_companion(*index));
        let sol = |index: &u32| self.known(*index).sol;
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
        let (path, kind) = (self.name(index), self.known(index).kind);
        let is_mask = || kind == OriginKind::Photo && is_mask(path, &|name| self.exists(name));
        kind != OriginKind::Unreadable && (is_camera_file(path) || is_mask())
    }

    fn product_key(&self, index: u32) -> String {
        // `x.img.xml` and the like label `x.img`.
        let inner = stem(self.name(index));
        let doubled = ["img", "png", "jpg"].contains(&extension(inner).as_str());
        join_key(if doubled { stem(inner) } else { inner })
    }
}

/// Returns what is known of files. Those that are not in the table, or changed since, are read.
fn known(
    ctx: &Ctx<'_>,
    source: &Source,
    files: &[WalkedFile],
    before: &Table,
) -> Result<Vec<Known>, StageError> {
    let known = |file: &WalkedFile| {
        ctx.check()?;
        let state = file.state.as_ref().ok();
        let state = state.filter(|_| source.reading == Reading::Changed);
        let known = state.and_then(|state| before.find(&file.name, state));
        Ok(known.cloned().unwrap_or_else(|| read(source, file)))
    };
    match ctx.threads {
        0 | 1 => files.iter().map(known).collect(),
        _ => files.par_iter().map(known).collect(),
    }
}

fn read(source: &Source, file: &WalkedFile) -> Known {
    let name = &file.name;
    let read = file.state.clone().and_then(|_| {
        let read = Known::read(name, &source.root.join(name), source.limit_bytes);
        read.map_err(|error| error.to_string())
    });
    read.unwrap_or_else(|reason| Known {
        digest: Digest::from_content(reason.as_bytes()),
        sol: ProductName::read(stem(name)).and_then(|product| product.sol),
        kind: OriginKind::Unreadable,
        reason: Some(reason),
    })
}

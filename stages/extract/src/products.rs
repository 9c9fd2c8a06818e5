//! Sorts the files of a shard into products: which file is the photo, which the label, which stays out and why.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use marf_cache::Digest;
use marf_pds::{Label, ProductName, join_key};
use marf_stage::{Ctx, OriginKind, StageError, Verdict};
use rayon::prelude::*;

use crate::archive::{ArchiveFile, ReadFile, extension, folder, read_label, stem};

/// A product: the files that may be its photo, best first, and its label.
pub(crate) struct Product {
    /// Unique in the archive: the product id, or the relative file name.
    pub id: String,
    /// What the name says, if it follows a scheme.
    pub name: Option<ProductName>,
    /// Candidates. The first that can be decoded is the photo.
    pub files: Vec<ArchiveFile>,
    /// Its label, if it is in a file of its own.
    pub label: Option<Detached>,
}

/// A label in a file of its own.
#[derive(Clone)]
pub(crate) struct Detached {
    /// Name of the file.
    pub name: String,
    /// Digest of its bytes, which are in the store.
    pub digest: Digest,
    /// Its values.
    pub label: Label,
}

/// The files of a shard, sorted into products.
pub(crate) struct Sorted {
    /// The products.
    pub products: Vec<Product>,
    /// A verdict for each file that is of no product.
    pub left_out: Vec<Verdict>,
    /// The labels, which were read.
    pub read: Vec<ReadFile>,
}

/// Reads the labels and joins files of one product by name, across folders.
///
/// # Errors
/// The store, the wish to stop, or a file that changed.
pub(crate) fn sort(ctx: &Ctx<'_>, files: &[ArchiveFile]) -> Result<Sorted, StageError> {
    let mut left_out = Vec::new();
    let mut photos: BTreeMap<String, Vec<ArchiveFile>> = BTreeMap::new();
    for file in files {
        match place(file) {
            Place::Photo(key) => photos.entry(key).or_default().push(file.clone()),
            Place::Label => {}
            Place::LeftOut(verdict, reason) => left_out.push(left(&file.name, verdict, reason)),
        }
    }
    let mut read = Vec::new();
    let mut labels = labels(ctx, files, &mut left_out, &mut read)?;
    let products = photos
        .into_values()
        .map(|files| product(files, &mut labels, &mut left_out))
        .collect();
    for (_, label) in labels
        .into_values()
        .flatten()
        .filter(|(used, _)| *used == Used::No)
    {
        left_out.push(left(
            &label.name,
            "skipped",
            "a label without its photo".to_owned(),
        ));
    }
    Ok(Sorted {
        products,
        left_out,
        read,
    })
}

/// Returns the verdict of a file that gives no photo.
pub(crate) fn left(file: &str, verdict: &str, reason: String) -> Verdict {
    Verdict {
        id: file.to_owned(),
        file: file.to_owned(),
        verdict: verdict.to_owned(),
        score: None,
        threshold: None,
        twin: None,
        reason,
    }
}

enum Place {
    /// A candidate for the product of this key.
    Photo(String),
    Label,
    /// Verdict and reason.
    LeftOut(&'static str, String),
}

fn place(file: &ArchiveFile) -> Place {
    let reason = || file.reason.clone().unwrap_or_default();
    match file.kind {
        OriginKind::Photo | OriginKind::Raw => match ProductName::read(stem(&file.name)) {
            Some(name) => match name.no_photo() {
                Some(reason) => Place::LeftOut("skipped", reason),
                None => Place::Photo(join_key(&name.id)),
            },
            None => Place::Photo(format!("/{}", file.name)),
        },
        OriginKind::Pds4 | OriginKind::Feed | OriginKind::Odl => Place::Label,
        OriginKind::Other => Place::LeftOut("skipped", reason()),
        OriginKind::Unreadable => Place::LeftOut("decode", reason()),
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Used {
    No,
    Yes,
}

/// Labels by the key of their product.
type Labels = BTreeMap<String, Vec<(Used, Detached)>>;

fn labels(
    ctx: &Ctx<'_>,
    files: &[ArchiveFile],
    left_out: &mut Vec<Verdict>,
    read: &mut Vec<ReadFile>,
) -> Result<Labels, StageError> {
    let is_label =
        |file: &ArchiveFile| matches!(file.kind, OriginKind::Pds4 | OriginKind::Feed | OriginKind::Odl);
    let label_files: Vec<&ArchiveFile> = files.iter().filter(|file| is_label(file)).collect();
    let outcomes: Result<Vec<_>, StageError> = label_files
        .into_par_iter()
        .map(|file| one_label(ctx, file))
        .collect();
    let photos: BTreeSet<String> = files
        .iter()
        .filter(|file| !is_label(file))
        .map(|file| join_key(stem(&file.name)))
        .collect();
    let mut labels = Labels::new();
    for (file, outcome) in outcomes? {
        read.push(file);
        match outcome {
            Ok(label) => labels
                .entry(label_key(&label, &photos))
                .or_default()
                .push((Used::No, label)),
            Err(verdict) => left_out.push(verdict),
        }
    }
    Ok(labels)
}

/// Reads and stores a label. An unreadable label is stored too, so that its verdict can be checked.
fn one_label(ctx: &Ctx<'_>, file: &ArchiveFile) -> Result<(ReadFile, Result<Detached, Verdict>), StageError> {
    ctx.check()?;
    let bytes = file.read(ctx)?;
    let digest = ctx.put(&bytes)?;
    let label = match read_label(file.kind, &bytes) {
        Ok(label) => Ok(Detached {
            name: file.name.clone(),
            digest,
            label,
        }),
        Err(reason) => Err(left(&file.name, "skipped", reason)),
    };
    Ok((ReadFile::new(file, &bytes), label))
}

/// A label is of the product that its file is named like, else of the file that it names.
fn label_key(label: &Detached, photos: &BTreeSet<String>) -> String {
    let inner = stem(&label.name);
    let doubled = ["img", "png", "jpg", "jpeg"].contains(&extension(inner).as_str());
    let own = join_key(if doubled { stem(inner) } else { inner });
    let named = label.label.array.as_ref().and_then(|array| array.file.as_deref());
    match named.map(|file| join_key(stem(file))) {
        Some(named) if !photos.contains(&own) && photos.contains(&named) => named,
        _ => own,
    }
}

fn product(mut files: Vec<ArchiveFile>, labels: &mut Labels, left_out: &mut Vec<Verdict>) -> Product {
    files.sort_by_cached_key(rank);
    let name = files.first().and_then(|file| ProductName::read(stem(&file.name)));
    let id = match (&name, files.first()) {
        (Some(name), _) => name.id.clone(),
        (None, Some(file)) => file.name.clone(),
        (None, None) => String::new(),
    };
    if let Some(name) = &name {
        let (current, older): (Vec<_>, Vec<_>) =
            files.into_iter().partition(|file| version(file) == name.version);
        left_out.extend(older.iter().map(|file| {
            let reason = format!("version {} is superseded by {}", version(file), name.version);
            left(&file.name, "skipped", reason)
        }));
        files = current;
    }
    let label = files.first().and_then(|file| label_of(file, labels));
    Product {
        id,
        name,
        files,
        label,
    }
}

/// Sorts candidates: the newest version, raw pixels before pictures made of them, lossless before lossy, full size
/// before pictures that a feed reduced (which have longer names).
fn rank(file: &ArchiveFile) -> (Reverse<String>, u8, usize, String) {
    let quality = match (file.kind, extension(&file.name).as_str()) {
        (OriginKind::Raw, _) => 0,
        (_, "png" | "tif" | "tiff" | "pnm" | "pgm" | "ppm") => 1,
        (_, "webp") => 2,
        (_, "jpg" | "jpeg") => 3,
        _ => 4,
    };
    (
        Reverse(version(file)),
        quality,
        stem(&file.name).len(),
        file.name.clone(),
    )
}

fn version(file: &ArchiveFile) -> String {
    ProductName::read(stem(&file.name))
        .map(|name| name.version)
        .unwrap_or_default()
}

/// Takes the label of a product: one with a camera first, then one in the photo's folder, then by name. A photo of no
/// known scheme takes labels of its own folder only.
fn label_of(file: &ArchiveFile, labels: &mut Labels) -> Option<Detached> {
    let scheme = ProductName::read(stem(&file.name)).is_some();
    let entries = labels.get_mut(&join_key(stem(&file.name)))?;
    let near = |label: &Detached| folder(&label.name) == folder(&file.name);
    let mut fitting: Vec<&mut (Used, Detached)> = entries
        .iter_mut()
        .filter(|(_, label)| scheme || near(label))
        .collect();
    fitting.iter_mut().for_each(|entry| entry.0 = Used::Yes);
    let best = fitting
        .into_iter()
        .min_by_key(|(_, label)| (label.label.prior.is_none(), !near(label), label.name.clone()));
    best.map(|(_, label)| label.clone())
}

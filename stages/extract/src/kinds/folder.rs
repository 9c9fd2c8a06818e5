//! An archive in a folder: photos with or without labels, feed records and companions, in any layout.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use marf_cache::{Digest, digest_of};
use marf_pds::join_key;
use marf_stage::{Ctx, Listing, ParamError, Shard, StageError};
use parking_lot::Mutex;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Deserialize;
use walkdir::{DirEntry, WalkDir};

use crate::archive::access::{Local, LocalContext};
use crate::archive::kind::ArchiveKind;
use crate::archive::{ArchiveFile, ArchiveFiles, Kind, extension, folder, stem};
use crate::sols::Sols;

/// Deepest folder that is entered.
const MAX_DEPTH: usize = 32;
/// Cameras and points of other programs, kept for `calibrate`.
const COMPANIONS: [&str; 9] = [
    "transforms.json",
    "cameras.bin",
    "cameras.txt",
    "images.bin",
    "images.txt",
    "points3D.bin",
    "points3D.txt",
    "points.ply",
    "sparse_pc.ply",
];
/// Folder of pictures that hide parts of photos; they are companions, not photos.
const MASKS: &str = "masks";
/// Folders in which companions are looked for.
const COMPANION_FOLDERS: [&str; 3] = ["", "sparse", "sparse/0"];

/// The keys of `kind = "folder"`.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct FolderParams {
    /// The folder; a relative one is meant from pipeline.toml.
    path: PathBuf,
    /// Which sols: `1..=5`, `3`, `1,4,7..=9` or `latest`; all, and photos of no known sol, if left out.
    #[serde(default)]
    #[schemars(with = "Sols")]
    sols: Option<Sols>,
    /// Whether folders in the folder are read too.
    #[serde(default = "yes")]
    recursive: bool,
}

fn yes() -> bool {
    true
}

/// A folder, and which of its files are photos of the archive.
pub(crate) struct Folder {
    root: PathBuf,
    sols: Sols,
    depth: usize,
    /// The last survey, so that fetching a shard reads what was listed. Files are checked by digest when read.
    last: Mutex<Option<Arc<Survey>>>,
}

/// The files of the folder.
struct Survey {
    shards: BTreeMap<u32, Vec<ArchiveFile>>,
    companions: Vec<ArchiveFile>,
}

impl ArchiveKind for Folder {
    type Params = FolderParams;
    type Location = Local;
    const KIND: &'static str = "folder";
    const ABOUT: &'static str = "a folder of photos, with or without labels beside them";

    fn open(params: FolderParams, context: LocalContext) -> Result<Box<dyn ArchiveFiles>, ParamError> {
        Ok(Box::new(Self {
            root: context.path(&params.path),
            sols: params.sols.unwrap_or(Sols::All),
            depth: if params.recursive { MAX_DEPTH } else { 1 },
            last: Mutex::new(None),
        }))
    }
}

impl Folder {
    /// Reads every file once and sorts them into shards and companions.
    fn survey(&self, ctx: &Ctx<'_>) -> Result<Arc<Survey>, StageError> {
        self.check_root()?;
        let found: Vec<_> = self.walk();
        let files: Result<Vec<ArchiveFile>, StageError> = found
            .into_par_iter()
            .map(|(name, place)| {
                ctx.check()?;
                Ok(match place {
                    Ok(path) => ArchiveFile::on_disk(name, path),
                    Err(reason) => ArchiveFile::unreadable(name, reason),
                })
            })
            .collect();
        let (companions, files): (Vec<_>, Vec<_>) = files?.into_iter().partition(is_companion);
        if !files
            .iter()
            .any(|file| matches!(file.kind, Kind::Photo | Kind::Raw))
        {
            return Err(self.empty(&files));
        }
        let shards = self.chosen(by_sol(files))?;
        let survey = Arc::new(Survey { shards, companions });
        *self.last.lock() = Some(Arc::clone(&survey));
        Ok(survey)
    }

    fn check_root(&self) -> Result<(), StageError> {
        let fail = |what: &str, hint: &str| {
            Err(StageError::new(format!("`{}` {what}", self.root.display())).hint(hint.to_owned()))
        };
        match std::fs::metadata(&self.root) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => fail(
                "does not exist",
                "set `path` of the archive to the folder that holds the photos",
            ),
            Err(error) => fail(
                &format!("cannot be read: {}", error.kind()),
                "check the folder's permissions",
            ),
            Ok(meta) if !meta.is_dir() => fail(
                "is a file, not a folder",
                "set `path` of the archive to its folder",
            ),
            Ok(_) => match std::fs::read_dir(&self.root) {
                Ok(_) => Ok(()),
                Err(error) => fail(
                    &format!("cannot be read: {}", error.kind()),
                    "check the folder's permissions",
                ),
            },
        }
    }

    fn empty(&self, files: &[ArchiveFile]) -> StageError {
        let path = self.root.display();
        let message = if files.is_empty() {
            format!("`{path}` is empty")
        } else {
            format!("`{path}` holds {} files and no photo", files.len())
        };
        StageError::new(message).hint("a photo is a JPEG, PNG, WebP, GIF or .IMG; hidden files are not read")
    }

    /// Returns every file by name, in order; hidden files and folders are left out, links are followed but not in circles.
    fn walk(&self) -> Vec<(String, Result<PathBuf, String>)> {
        let visible =
            |entry: &DirEntry| entry.depth() == 0 || !entry.file_name().as_encoded_bytes().starts_with(b".");
        let walk = WalkDir::new(&self.root)
            .follow_links(true)
            .max_depth(self.depth)
            .sort_by_file_name();
        let entries = walk.into_iter().filter_entry(visible);
        let mut found: Vec<_> = entries.filter_map(|entry| self.entry(entry)).collect();
        found.sort_by(|a, b| a.0.cmp(&b.0));
        found.dedup_by(|a, b| a.0 == b.0); // only names that are no UTF-8 can collide
        found
    }

    fn entry(&self, entry: walkdir::Result<DirEntry>) -> Option<(String, Result<PathBuf, String>)> {
        match entry {
            Ok(entry) if entry.file_type().is_dir() => None,
            Ok(entry) => {
                let (name, whole) = self.relative(entry.path());
                let place = match (entry.file_type().is_file(), whole) {
                    (false, _) => Err("not a plain file".to_owned()),
                    (_, false) => Err("its name is not UTF-8".to_owned()),
                    _ => Ok(entry.into_path()),
                };
                Some((name, place))
            }
            Err(error) => {
                let (name, _) = self.relative(error.path()?);
                let reason = match (error.loop_ancestor(), error.io_error()) {
                    (Some(_), _) => "a link that leads back to a folder above it".to_owned(),
                    (_, Some(io)) => format!("cannot be read: {}", io.kind()),
                    _ => "cannot be read".to_owned(),
                };
                Some((name, Err(reason)))
            }
        }
    }

    /// Returns the name below the folder with `/`, and whether it is UTF-8.
    fn relative(&self, path: &Path) -> (String, bool) {
        let below = path.strip_prefix(&self.root).unwrap_or(path);
        let parts: Vec<_> = below.iter().map(|part| part.to_string_lossy()).collect();
        (parts.join("/"), below.to_str().is_some())
    }

    /// Returns the shards of the sols asked for.
    fn chosen(
        &self,
        shards: BTreeMap<u32, Vec<ArchiveFile>>,
    ) -> Result<BTreeMap<u32, Vec<ArchiveFile>>, StageError> {
        // A shard of labels alone is of no photo; "latest" means photos.
        let photos = |files: &Vec<ArchiveFile>| {
            files
                .iter()
                .any(|file| matches!(file.kind, Kind::Photo | Kind::Raw))
        };
        let present: BTreeSet<u32> = shards
            .iter()
            .filter(|(_, files)| photos(files))
            .map(|(sol, _)| *sol)
            .collect();
        if self.sols == Sols::All {
            return Ok(shards);
        }
        let wanted = self.sols.choose(&present);
        if wanted.is_empty() {
            let (first, last) = (present.first().unwrap_or(&0), present.last().unwrap_or(&0));
            return Err(StageError::new(format!(
                "`{}` has no photo of the sols asked for; its photos are of {} sols from {first} to {last}",
                self.root.display(),
                present.len()
            ))
            .hint("change `sols` of the archive, or leave it out for all"));
        }
        Ok(shards
            .into_iter()
            .filter(|(sol, _)| wanted.contains(sol))
            .collect())
    }
}

impl ArchiveFiles for Folder {
    fn list(&self, ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        let survey = self.survey(ctx)?;
        let mut companions = BTreeMap::new();
        for file in &survey.companions {
            companions.insert(file.name.clone(), ctx.put(&file.read(ctx)?)?);
        }
        let shards = survey.shards.iter().map(|(shard, files)| Shard {
            shard: *shard,
            fingerprint: fingerprint(files),
        });
        Ok(Listing {
            shards: shards.collect(),
            companions,
            note: None,
        })
    }

    fn files(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Vec<ArchiveFile>, StageError> {
        let last = self.last.lock().clone();
        let survey = match last {
            Some(survey) => survey,
            None => self.survey(ctx)?,
        };
        let files = survey.shards.get(&shard).cloned();
        files.ok_or_else(|| StageError::new(format!("`{}` has no files of sol {shard}", self.root.display())))
    }
}

/// Returns the digest over names and digests of all files of a shard.
fn fingerprint(files: &[ArchiveFile]) -> Digest {
    let content: Vec<(String, Digest)> = files
        .iter()
        .map(|file| (file.name.clone(), file.digest))
        .collect();
    digest_of(&content)
}

fn is_companion(file: &ArchiveFile) -> bool {
    let name = file.name.rsplit('/').next().unwrap_or_default();
    let readable = !matches!(file.kind, Kind::Unreadable(_));
    let cameras = COMPANIONS.contains(&name) && COMPANION_FOLDERS.contains(&folder(&file.name));
    let mask = file.kind == Kind::Photo && folder(&file.name).split('/').any(|part| part == MASKS);
    readable && (cameras || mask)
}

/// Sorts files into sols: a file whose name tells no sol goes with the label or photo of its product.
fn by_sol(files: Vec<ArchiveFile>) -> BTreeMap<u32, Vec<ArchiveFile>> {
    let mut sols: BTreeMap<String, u32> = BTreeMap::new();
    for file in &files {
        if let Some(sol) = file.sol {
            sols.entry(product_key(file)).or_insert(sol);
        }
    }
    let mut shards: BTreeMap<u32, Vec<ArchiveFile>> = BTreeMap::new();
    for file in files {
        let sol = file
            .sol
            .or_else(|| sols.get(&product_key(&file)).copied())
            .unwrap_or(0);
        shards.entry(sol).or_default().push(file);
    }
    shards
}

fn product_key(file: &ArchiveFile) -> String {
    // `x.img.xml` and the like label `x.img`.
    let inner = stem(&file.name);
    let doubled = ["img", "png", "jpg"].contains(&extension(inner).as_str());
    join_key(if doubled { stem(inner) } else { inner })
}

//! An archive in a folder: photos with or without labels, feed records and companions, in any layout.
//!
//! ```text
//! walk.rs        every file, by name, with its state
//! table.rs       entries of files from earlier runs
//! companions.rs  cameras and masks next to photos
//! survey.rs      combines these and sorts files into sols
//! ```

mod companions;
mod survey;
mod table;
#[cfg(test)]
mod tests;
mod walk;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;

use marf_cache::Digest;
use marf_stage::{Ctx, Files, Keep, Listing, ParamError, Shard, StageError};
use parking_lot::Mutex;
use schemars::JsonSchema;
use serde::Deserialize;

use self::survey::{Reading, Source, Survey};
use self::walk::MAX_DEPTH;
use crate::archive::access::{Local, LocalContext};
use crate::archive::kind::ArchiveKind;
use crate::archive::{ArchiveFiles, ShardFiles};
use marf_stage::Sols;

/// The keys of `kind = "folder"`.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct FolderParams {
    /// The folder. A relative path starts at the folder of pipeline.toml.
    path: PathBuf,
    /// Sols: `1..=5`, `3`, `1,4,7..=9` or `latest`. Default: all sols, and photos of unknown sol.
    #[serde(default)]
    #[schemars(with = "Sols")]
    sols: Option<Sols>,
    /// Whether folders in the folder are read too.
    #[serde(default = "yes")]
    recursive: bool,
    /// `"copy"` stores the bytes of the photos. `"reference"` stores links: nothing is copied, but a photo that is
    /// later edited or removed is lost to audits and replays. Takes effect when a photo is read.
    #[serde(default)]
    keep: Keep,
    /// Largest file that is read, in MB. A larger one is left out, with the reason.
    #[serde(default = "max_file_mb")]
    max_file_mb: u64,
}

fn yes() -> bool {
    true
}

/// 333 megapixels of 16-bit colour.
fn max_file_mb() -> u64 {
    2_000
}

/// A folder, and which of its files are photos of the archive.
pub(crate) struct Folder {
    source: Source,
    sols: Sols,
    /// The last survey, so that fetching a shard reads the listed files. Files are checked by digest when read.
    last: Mutex<Option<Arc<Survey>>>,
}

impl ArchiveKind for Folder {
    type Params = FolderParams;
    type Location = Local;
    const KIND: &'static str = "folder";
    const ABOUT: &'static str = "a folder of photos, with or without labels next to them";

    fn open(params: FolderParams, context: LocalContext) -> Result<Box<dyn ArchiveFiles>, ParamError> {
        Ok(Box::new(Self {
            source: Source {
                root: context.path(&params.path),
                depth: if params.recursive { MAX_DEPTH } else { 1 },
                reading: if context.rehash() {
                    Reading::All
                } else {
                    Reading::Changed
                },
                keep: params.keep,
                limit_bytes: params.max_file_mb.saturating_mul(1_000_000),
            },
            sols: params.sols.unwrap_or(Sols::All),
            last: Mutex::new(None),
        }))
    }
}

impl Folder {
    /// Returns the files of the folder, of the sols asked for.
    fn survey(&self, ctx: &Ctx<'_>) -> Result<Arc<Survey>, StageError> {
        self.check_root()?;
        let mut survey = Survey::new(ctx, &self.source)?;
        let mut files = survey.shards.values().flatten();
        // A folder of masks alone is for photos of another archive.
        if survey.companions.is_empty() && !files.any(|index| survey.is_photo(*index)) {
            return Err(self.empty(survey.shards.values().map(Vec::len).sum()));
        }
        self.choose(&mut survey)?;
        let survey = Arc::new(survey);
        *self.last.lock() = Some(Arc::clone(&survey));
        Ok(survey)
    }

    /// Returns the last survey, or makes the first.
    fn listed(&self, ctx: &Ctx<'_>) -> Result<Arc<Survey>, StageError> {
        let last = self.last.lock().clone();
        last.map_or_else(|| self.survey(ctx), Ok)
    }

    fn files_of<'a>(&self, survey: &'a Survey, shard: u32) -> Result<&'a [u32], StageError> {
        let files = survey.shards.get(&shard);
        files.map(Vec::as_slice).ok_or_else(|| {
            StageError::new(format!(
                "`{}` has no files of sol {shard}",
                self.source.root.display()
            ))
        })
    }

    /// Returns the folder in words: its own name alone, since records name no folder of a machine.
    fn place(&self) -> Option<String> {
        let root = std::path::absolute(&self.source.root).ok()?;
        Some(format!("folder `{}`", root.file_name()?.to_string_lossy()))
    }

    fn check_root(&self) -> Result<(), StageError> {
        let fail = |what: &str, hint: &str| {
            Err(StageError::new(format!("`{}` {what}", self.source.root.display())).hint(hint.to_owned()))
        };
        match std::fs::metadata(&self.source.root) {
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
            Ok(_) => match std::fs::read_dir(&self.source.root) {
                Ok(_) => Ok(()),
                Err(error) => fail(
                    &format!("cannot be read: {}", error.kind()),
                    "check the folder's permissions",
                ),
            },
        }
    }

    fn empty(&self, files: usize) -> StageError {
        let path = self.source.root.display();
        let message = match files {
            0 => format!("`{path}` is empty"),
            1 => format!("`{path}` has 1 file, which is not a photo"),
            _ => format!("`{path}` has {files} files, and none is a photo"),
        };
        StageError::new(message)
            .hint("a photo is a JPEG, PNG, WebP, GIF, TIFF, PNM or .IMG. Hidden files are not read")
    }

    /// Leaves the shards of the sols asked for.
    fn choose(&self, survey: &mut Survey) -> Result<(), StageError> {
        if self.sols == Sols::All {
            return Ok(());
        }
        // A shard that has only labels does not count: "latest" means the latest photos.
        let with_photo = survey
            .shards
            .iter()
            .filter(|(_, files)| files.iter().any(|index| survey.is_photo(*index)));
        let present: BTreeSet<u32> = with_photo.map(|(sol, _)| *sol).collect();
        let wanted = self.sols.choose(&present);
        if wanted.is_empty() {
            let (first, last) = (present.first().unwrap_or(&0), present.last().unwrap_or(&0));
            return Err(StageError::new(format!(
                "`{}` has no photo of the requested sols: the sols of its photos are {first} to {last} ({} in all)",
                self.source.root.display(),
                present.len()
            ))
            .hint("change `sols` of the archive, or leave it out for all"));
        }
        survey.shards.retain(|sol, _| wanted.contains(sol));
        Ok(())
    }
}

impl ArchiveFiles for Folder {
    fn list(&self, ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        let survey = self.survey(ctx)?;
        let mut companions = BTreeMap::new();
        for index in &survey.companions {
            let file = survey.file(&self.source, *index);
            if !ctx.blobs.contains(&file.digest) {
                file.keep(ctx)?;
            }
            companions.insert(file.name, file.digest);
        }
        let shards = survey.shards.iter().map(|(shard, files)| Shard {
            shard: *shard,
            fingerprint: Digest::from_content(&survey.digests(files).encode()),
        });
        Ok(Listing {
            shards: shards.collect(),
            companions,
            place: self.place(),
            ..Listing::default()
        })
    }

    fn digests(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Option<Files>, StageError> {
        let survey = self.listed(ctx)?;
        Ok(Some(survey.digests(self.files_of(&survey, shard)?)))
    }

    fn files(&self, ctx: &Ctx<'_>, shard: u32) -> Result<ShardFiles, StageError> {
        let survey = self.listed(ctx)?;
        let files = self.files_of(&survey, shard)?.iter();
        Ok(ShardFiles {
            files: files.map(|index| survey.file(&self.source, *index)).collect(),
            ..ShardFiles::default()
        })
    }
}

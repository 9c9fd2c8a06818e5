//! Parameters of the stage: which archive.

use std::collections::BTreeMap;
use std::path::PathBuf;

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::Deserialize;

use crate::archive::ArchiveFiles;
use crate::built_in::BuiltIn;
use crate::folder::{Depth, Folder};
use crate::sols::Sols;

/// Where photos come from.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExtractParams {
    /// Name of an `[archive.*]` table.
    pub archive: Archive,
}

/// A place that photos come from.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Archive {
    /// A folder of photos, with or without labels beside them.
    Folder(FolderArchive),
    /// The built-in Mars: needs no network.
    Demo(DemoArchive),
    /// The Planetary Data System over the network; not in this version.
    Pds(OtherArchive),
    /// NASA's raw-image feeds over the network; not in this version.
    Feed(OtherArchive),
}

/// A folder of photos.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FolderArchive {
    /// The folder; a relative one is meant from pipeline.toml.
    pub path: PathBuf,
    /// Which sols: `1..=5`, `3`, `1,4,7..=9` or `latest`; all, and photos of no known sol, if left out.
    #[serde(default, deserialize_with = "some_text_or_number")]
    pub sols: Option<String>,
    /// Whether folders in the folder are read too.
    #[serde(default = "yes")]
    pub recursive: bool,
}

/// The built-in Mars.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DemoArchive {
    /// Which sols, as `1..=2` or a list.
    #[serde(default = "first_sols", deserialize_with = "text_or_number")]
    pub sols: String,
    /// Seed of the terrain.
    #[serde(default = "demo_seed")]
    pub seed: u64,
    /// Width of a photo, pixels.
    #[serde(default = "demo_width")]
    pub width: u32,
}

/// An archive of a later version; its keys are taken as they are.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct OtherArchive {
    /// Its keys.
    #[serde(flatten)]
    pub keys: BTreeMap<String, serde_json::Value>,
}

fn yes() -> bool {
    true
}

/// One sol may be written as a bare number.
fn text_or_number<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected sols like \"1..=3\" or a number")]
    enum Either {
        Text(String),
        Number(u32),
    }
    Ok(match Either::deserialize(deserializer)? {
        Either::Text(text) => text,
        Either::Number(sol) => sol.to_string(),
    })
}

fn some_text_or_number<'de, D: serde::Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<String>, D::Error> {
    text_or_number(deserializer).map(Some)
}

fn first_sols() -> String {
    "1..=2".to_owned()
}

fn demo_seed() -> u64 {
    1
}

fn demo_width() -> u32 {
    640
}

impl ExtractParams {
    /// Checks the parameters and opens the archive; nothing is read yet.
    pub(crate) fn open(self) -> Result<Box<dyn ArchiveFiles>, ParamError> {
        match self.archive {
            Archive::Folder(folder) => {
                let sols = folder.sols.as_deref().map_or(Ok(Sols::All), Sols::parse);
                let sols = sols.map_err(|message| ParamError::new("archive.sols", message))?;
                let depth = if folder.recursive {
                    Depth::Recursive
                } else {
                    Depth::Flat
                };
                Ok(Box::new(Folder::new(folder.path, sols, depth)))
            }
            Archive::Demo(demo) => Ok(Box::new(BuiltIn::new(&demo)?)),
            Archive::Pds(_) => Err(later("pds")),
            Archive::Feed(_) => Err(later("feed")),
        }
    }
}

fn later(kind: &str) -> ParamError {
    let message =
        format!("archives of kind `{kind}` are not in this version; use kind = \"folder\" on a local copy");
    ParamError::new("archive.kind", message)
}

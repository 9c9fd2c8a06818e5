//! Parameters of the stage: which archive.

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
    /// The Planetary Data System, over the network.
    Pds(PdsArchive),
    /// NASA's raw-image feeds, over the network.
    Feed(FeedArchive),
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

/// One camera of one mission in the Planetary Data System.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PdsArchive {
    /// The mission.
    pub mission: Mission,
    /// The camera.
    pub instrument: Instrument,
    /// Which sols: `1..=5`, `3`, `1,4,7..=9` or `latest`.
    #[serde(deserialize_with = "text_or_number")]
    pub sols: String,
    /// How far the products were worked on; `edr` is raw.
    #[serde(default)]
    pub level: Level,
    /// Where pixels come from; labels come from beside the `.IMG` either way.
    #[serde(default)]
    pub pixels: PixelSource,
    /// Product types, the preferred first; of an exposure the first that exists is taken. Left out: the usual ones.
    #[serde(default)]
    pub products: Vec<String>,
    /// How products are found.
    #[serde(default)]
    pub discover: Discover,
    /// Where the archive lies: folders that hold `mars2020/` and `msl/`, tried in this order.
    #[serde(default)]
    pub base: Vec<String>,
    /// How the network is used.
    #[serde(default)]
    pub network: Network,
    /// Set by the program.
    #[serde(default)]
    #[schemars(skip)]
    pub site: Site,
}

/// The raw-image feed of one mission.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FeedArchive {
    /// The mission.
    pub mission: Mission,
    /// The camera.
    pub instrument: Instrument,
    /// Which sols: `1..=5`, `3`, `1,4,7..=9` or `latest`.
    #[serde(deserialize_with = "text_or_number")]
    pub sols: String,
    /// Where the feed lies, tried in this order.
    #[serde(default)]
    pub base: Vec<String>,
    /// Hosts that pictures may come from, beside those of `base`.
    #[serde(default)]
    pub picture_hosts: Vec<String>,
    /// How the network is used.
    #[serde(default)]
    pub network: Network,
    /// Set by the program.
    #[serde(default)]
    #[schemars(skip)]
    pub site: Site,
}

/// A mission.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Mission {
    /// Mars 2020's rover.
    Perseverance,
    /// Mars 2020's helicopter.
    Ingenuity,
    /// Mars Science Laboratory.
    Curiosity,
}

/// A camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Instrument {
    /// Perseverance's zoom pair.
    MastcamZ,
    /// The navigation pair of either rover.
    Navcam,
    /// Both cameras of the helicopter.
    Helicam,
    /// Curiosity's pair.
    Mastcam,
}

/// How far products were worked on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Raw.
    #[default]
    Edr,
    /// Geometry refined; Mars 2020 only.
    Fdr,
    /// Calibrated.
    Rdr,
}

/// Where pixels come from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PixelSource {
    /// PNG of 8 bits; Mars 2020 only, elsewhere the same as `img`.
    #[default]
    Browse,
    /// The `.IMG` as archived, 16 bits and more.
    Img,
}

/// How products are found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Discover {
    /// Folder pages, sol by sol.
    #[default]
    Listing,
    /// The inventory of the collection, one file for all sols; Mars 2020 only.
    Inventory,
    /// The index tables of the volumes; Curiosity's Mastcam only.
    Index,
}

/// How the network is used.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Network {
    /// Requests at a time to one host, 1 to 4.
    pub connections: usize,
    /// Least time between two requests to one host, ms.
    pub delay_ms: u64,
    /// How often a request is tried, 1 to 10.
    pub tries: u32,
    /// First wait before another try, ms; it doubles, up to a minute.
    pub retry_ms: u64,
    /// Longest silence of a server, s.
    pub stall_s: u64,
    /// Sols younger than the newest by less than this are listed again at each run: products arrive late.
    pub relist_sols: u32,
    /// Address for those who look after the server; goes into the User-Agent.
    pub contact: Option<String>,
}

impl Default for Network {
    fn default() -> Self {
        Self {
            connections: 2,
            delay_ms: 250,
            tries: 5,
            retry_ms: 1_000,
            stall_s: 30,
            relist_sols: 30,
            contact: None,
        }
    }
}

/// What the program tells an archive of the place it works in; never part of a key.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
pub struct Site {
    /// Name of the `[archive.*]` table.
    pub name: String,
    /// The lock file.
    pub lock: PathBuf,
    /// What may be asked of the network.
    pub access: Access,
}

/// What may be asked of the network.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Access {
    /// Lists, and fetches what is new.
    #[default]
    Online,
    /// Takes exactly what the lock file names; fetches what of it is not in the store.
    Locked,
    /// As `locked`, and opens no connection.
    Offline,
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
            Archive::Pds(pds) => Ok(Box::new(crate::remote::pds(pds)?)),
            Archive::Feed(feed) => Ok(Box::new(crate::remote::feed(feed)?)),
        }
    }
}

//! Products found in tables instead of folder pages: the inventory of a collection, the indices of volumes.

use std::collections::{BTreeMap, BTreeSet};

use marf_pds::index_table::{Index, IndexError};
use marf_pds::{ProductName, inventory};
use marf_stage::{ParamError, StageError};

use super::crawl::{Crawl, memory_key, recall, remember, urls};
use super::offer::Survey;
use super::pds::{Found, Pds};
use super::trees::Tree;
use crate::net::{Answer, Validators, Want};
use crate::params::Discover;
use crate::sols::Sols;

/// Largest inventory or index that is read.
const MAX_TABLE_BYTES: u64 = 128 << 20;
/// Name of a collection's inventory.
const INVENTORY: &str = "collection_data_inventory.csv";
/// Label and table of a volume's index of decompressed products.
const INDEX: [&str; 2] = ["RDRINDEX.LBL", "RDRINDEX.TAB"];

impl Pds {
    /// Checks that products can be found as asked for.
    ///
    /// # Errors
    /// A camera without inventory or index.
    pub fn check(&self) -> Result<(), ParamError> {
        let volumes = self
            .holding
            .layouts
            .iter()
            .flatten()
            .all(|tree| tree.volumes.is_some());
        match self.discover {
            Discover::Inventory if self.holding.collection.is_none() => Err(ParamError::new(
                "archive.discover",
                "this camera's archive has no inventory; use \"listing\" or \"index\"".to_owned(),
            )),
            Discover::Index if !volumes => Err(ParamError::new(
                "archive.discover",
                "this camera's archive has no index tables; use \"listing\" or \"inventory\"".to_owned(),
            )),
            _ => Ok(()),
        }
    }
}

/// Finds products in the inventory of the collection: names without folders, dates and versions. The version is taken
/// to be that of the identifier; a product whose file has another is listed as gone.
pub(super) fn by_inventory(pds: &Pds, crawl: &Crawl<'_>, sols: &Sols) -> Result<Survey, StageError> {
    let collection = pds.holding.collection.as_deref().unwrap_or_default();
    let path = format!("{collection}/{INVENTORY}");
    let table = whole(crawl, &path)?;
    let members = inventory::read(&table).map_err(|error| unreadable(&path, &error.to_string()))?;
    let mut found: BTreeMap<u32, Vec<Found>> = BTreeMap::new();
    for member in members.iter().filter(|member| member.primary) {
        let Some(stem) = inventory::file_stems(member).into_iter().next() else {
            continue;
        };
        let Some(sol) = ProductName::read(&stem).and_then(|name| name.sol) else {
            continue;
        };
        for tree in pds.holding.layouts.iter().flatten() {
            found.entry(sol).or_default().extend(files_of(tree, sol, &stem));
        }
    }
    chosen(pds, found, sols)
}

/// The files of a product in a tree, as they are named.
fn files_of(tree: &Tree, sol: u32, stem: &str) -> Vec<Found> {
    let digits = tree.sol.1;
    let folder = tree.products(&tree.root, &format!("{}{sol:0digits$}", tree.sol.0));
    let file = |extension: &&str| Found {
        folder: folder.clone(),
        name: match *extension {
            "img" => format!("{stem}.IMG"),
            extension => format!("{stem}.{extension}"),
        },
        modified: None,
    };
    tree.takes.iter().map(file).collect()
}

/// Finds products in the indices of all volumes.
pub(super) fn by_index(pds: &Pds, crawl: &Crawl<'_>, sols: &Sols) -> Result<Survey, StageError> {
    let mut found: BTreeMap<u32, Vec<Found>> = BTreeMap::new();
    for tree in pds.holding.layouts.iter().flatten() {
        let volumes = crawl.folder(&tree.root)?.unwrap_or_default();
        for volume in volumes
            .iter()
            .filter(|entry| entry.folder && tree.is_volume(&entry.name))
        {
            let root = format!("{}/{}", tree.root, volume.name);
            for (sol, mut files) in index_of(crawl, &root)? {
                found.entry(sol).or_default().append(&mut files);
            }
        }
    }
    chosen(pds, found, sols)
}

/// The products of one volume, by sol: label and pixels of each.
fn index_of(crawl: &Crawl<'_>, volume: &str) -> Result<BTreeMap<u32, Vec<Found>>, StageError> {
    let paths = INDEX.map(|name| format!("{volume}/INDEX/{name}"));
    let bad = |error: IndexError| unreadable(&paths[1], &error.to_string());
    let index = Index::of(&whole(crawl, &paths[0])?).map_err(bad)?;
    let table = whole(crawl, &paths[1])?;
    let mut found: BTreeMap<u32, Vec<Found>> = BTreeMap::new();
    for row in index.rows(table.as_slice()) {
        let place = row.map_err(bad)?.place();
        let (Some(sol), Some(path), Some(file)) = (place.sol, place.path, place.file) else {
            continue;
        };
        let stem = crate::archive::stem(&file).to_owned();
        found
            .entry(sol)
            .or_default()
            .extend([".LBL", ".IMG"].map(|end| Found {
                folder: format!("{volume}/{path}"),
                name: format!("{stem}{end}"),
                modified: None,
            }));
    }
    Ok(found)
}

fn chosen(pds: &Pds, mut found: BTreeMap<u32, Vec<Found>>, sols: &Sols) -> Result<Survey, StageError> {
    let present: BTreeSet<u32> = found.keys().copied().collect();
    let chosen = sols.choose(&present);
    found.retain(|sol, _| chosen.contains(sol));
    Ok(Survey {
        offers: pds.offers(found)?,
        present,
    })
}

/// Brings a table; one that did not change since is taken from memory.
fn whole(crawl: &Crawl<'_>, path: &str) -> Result<Vec<u8>, StageError> {
    let key = memory_key("table", path);
    let memory: Option<(Validators, String)> = recall(crawl.ctx.scratch, &key);
    let want = Want {
        urls: urls(crawl.bases, path)?,
        cap_bytes: MAX_TABLE_BYTES,
        known: memory.as_ref().map(|memory| memory.0.clone()),
        part: None,
    };
    let mut got = None;
    crawl.client.get_all(crawl.ctx, &[want], &mut |_, answer| {
        got = Some(answer?);
        Ok(())
    })?;
    match got {
        Some(Answer::Whole {
            bytes, validators, ..
        }) => {
            // A table is ASCII; one that is no text is not remembered, so that the next run sees the same bytes.
            if let Ok(text) = std::str::from_utf8(&bytes) {
                remember(crawl.ctx.scratch, &key, &(validators, text));
            }
            Ok(bytes)
        }
        Some(Answer::Unchanged) => Ok(memory.map(|memory| memory.1.into_bytes()).unwrap_or_default()),
        _ => Err(StageError::new(format!("the archive has no `{path}`"))
            .cause(format!("asked at {}", crawl.bases.join(", ")))
            .hint("find products by `discover = \"listing\"`, or set `base` of the archive")),
    }
}

fn unreadable(path: &str, cause: &str) -> StageError {
    StageError::new(format!("`{path}` cannot be read"))
        .cause(cause)
        .hint("find products by `discover = \"listing\"`")
}

//! Products found in tables instead of folder pages: the inventory of a collection, the indices of volumes.

use std::collections::BTreeMap;

use marf_pds::index_table::{Index, IndexError};
use marf_pds::{ProductName, inventory};
use marf_stage::StageError;

use super::layout::Tree;
use super::products::{FoundFile, Products};
use crate::net::{Answer, Download, Validators};
use crate::remote::cache;
use crate::remote::catalog::Catalog;
use crate::remote::crawl::{Crawl, urls};
use crate::sols::Sols;

/// Largest inventory or index that is read.
const MAX_TABLE_BYTES: u64 = 128 << 20;
/// Name of a collection's inventory.
const INVENTORY: &str = "collection_data_inventory.csv";
/// Label and table of a volume's index of decompressed products.
const INDEX: [&str; 2] = ["RDRINDEX.LBL", "RDRINDEX.TAB"];

/// Finds products in the inventory of the collection: names without folders, dates and versions. The version is taken
/// to be that of the identifier; a product whose file has another is listed as gone.
pub(super) fn by_inventory(
    products: &Products,
    crawl: &Crawl<'_>,
    sols: &Sols,
) -> Result<Catalog, StageError> {
    let collection = products.layout.collection.as_deref().unwrap_or_default();
    let path = format!("{collection}/{INVENTORY}");
    let table = table(crawl, &path)?;
    let members = inventory::read(&table).map_err(|error| unreadable(&path, &error.to_string()))?;
    let mut found: BTreeMap<u32, Vec<FoundFile>> = BTreeMap::new();
    for member in members.iter().filter(|member| member.primary) {
        let Some(stem) = inventory::file_stems(member).into_iter().next() else {
            continue;
        };
        let Some(sol) = ProductName::read(&stem).and_then(|name| name.sol) else {
            continue;
        };
        for tree in products.layout.layouts.iter().flatten() {
            found.entry(sol).or_default().extend(files_of(tree, sol, &stem));
        }
    }
    products.chosen(found, sols)
}

/// Returns the files of a product in a tree, as they are named.
fn files_of(tree: &Tree, sol: u32, stem: &str) -> Vec<FoundFile> {
    let digits = tree.sol.1;
    let folder = tree.products(&tree.root, &format!("{}{sol:0digits$}", tree.sol.0));
    let file = |extension: &&str| FoundFile {
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
pub(super) fn by_index(products: &Products, crawl: &Crawl<'_>, sols: &Sols) -> Result<Catalog, StageError> {
    let mut found: BTreeMap<u32, Vec<FoundFile>> = BTreeMap::new();
    for tree in products.layout.layouts.iter().flatten() {
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
    products.chosen(found, sols)
}

/// Returns the products of one volume, by sol: label and pixels of each.
fn index_of(crawl: &Crawl<'_>, volume: &str) -> Result<BTreeMap<u32, Vec<FoundFile>>, StageError> {
    let paths = INDEX.map(|name| format!("{volume}/INDEX/{name}"));
    let bad = |error: IndexError| unreadable(&paths[1], &error.to_string());
    let index = Index::of(&table(crawl, &paths[0])?).map_err(bad)?;
    let table = table(crawl, &paths[1])?;
    let mut found: BTreeMap<u32, Vec<FoundFile>> = BTreeMap::new();
    for row in index.rows(table.as_slice()) {
        let location = row.map_err(bad)?.location();
        let (Some(sol), Some(path), Some(file)) = (location.sol, location.path, location.file) else {
            continue;
        };
        let stem = crate::archive::stem(&file).to_owned();
        found
            .entry(sol)
            .or_default()
            .extend([".LBL", ".IMG"].map(|end| FoundFile {
                folder: format!("{volume}/{path}"),
                name: format!("{stem}{end}"),
                modified: None,
            }));
    }
    Ok(found)
}

/// Downloads a table; one that did not change since is taken from the cache.
fn table(crawl: &Crawl<'_>, path: &str) -> Result<Vec<u8>, StageError> {
    let key = cache::key("table", path);
    let cached: Option<(Validators, String)> = cache::read(crawl.ctx.scratch, &key);
    let want = Download {
        urls: urls(crawl.bases, path)?,
        cap_bytes: MAX_TABLE_BYTES,
        known: cached.as_ref().map(|cached| cached.0.clone()),
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
            // A table is ASCII; one that is no text is not cached, so that the next run sees the same bytes.
            if let Ok(text) = std::str::from_utf8(&bytes) {
                cache::write(crawl.ctx.scratch, &key, &(validators, text));
            }
            Ok(bytes)
        }
        Some(Answer::Unchanged) => Ok(cached.map(|cached| cached.1.into_bytes()).unwrap_or_default()),
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

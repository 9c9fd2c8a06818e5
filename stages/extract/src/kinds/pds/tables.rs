//! Products found in tables instead of folder pages: the inventory of a collection, the indices of volumes.
//!
//! A table is asked for on condition that it changed. What it names is kept by sol, so that a run with nothing new reads
//! none of it. The indices take one question for the list of volumes and one for each volume that is not closed.

use std::collections::{BTreeMap, BTreeSet};

use marf_pds::ProductName;
use marf_pds::index_table::{Index, IndexError};
use marf_pds::inventory::{self, InventoryError};
use marf_stage::StageError;

use super::layout::Tree;
use super::products::{FoundFile, Products};
use crate::net::{Answer, Validators};
use crate::remote::catalog::{Catalog, Question, SolListing};
use crate::remote::crawl::Crawl;
use crate::remote::pages::{PageState, Pages};

/// Largest inventory or index that is read.
pub(super) const MAX_TABLE_BYTES: u64 = 128 << 20;
/// Name of a collection's inventory.
pub(super) const INVENTORY: &str = "collection_data_inventory.csv";
/// Label and table of a volume's index of decompressed products.
pub(super) const INDEX: [&str; 2] = ["RDRINDEX.LBL", "RDRINDEX.TAB"];
/// Separates the path of a table from a sol, in the name of the page with the table's products of that sol.
const OF_SOL: char = '#';

/// Products by sol.
pub(super) type BySol = BTreeMap<u32, Vec<FoundFile>>;

/// Finds products in the inventory of the collection, which has names without folders, dates and versions. The
/// version is assumed to be that of the identifier. A product whose file has another version is listed as gone.
pub(super) fn by_inventory(
    products: &Products,
    crawl: &mut Crawl<'_>,
    question: Question<'_>,
) -> Result<Catalog, StageError> {
    let collection = products.layout.collection.as_deref().unwrap_or_default();
    let path = format!("{collection}/{INVENTORY}");
    for table in changed(crawl, std::slice::from_ref(&path))? {
        let found =
            by_members(products, &table.bytes).map_err(|error| unreadable(&path, &error.to_string()))?;
        keep(crawl.pages, &path, table.validators, &found);
    }
    Ok(catalog(crawl.pages, &[path], question))
}

/// Returns the products that an inventory names.
pub(super) fn by_members(products: &Products, bytes: &[u8]) -> Result<BySol, InventoryError> {
    let mut found = BySol::new();
    for member in inventory::read(bytes)?.iter().filter(|member| member.primary) {
        let Some(stem) = inventory::file_stems(member).into_iter().next() else {
            continue;
        };
        let Some(sol) = ProductName::read(&stem).and_then(|name| name.sol) else {
            continue;
        };
        for tree in products.layout.layouts.iter().flatten() {
            found
                .entry(sol)
                .or_default()
                .extend(files_named(tree, sol, &stem));
        }
    }
    Ok(found)
}

/// Returns the files of a product in a tree, as they are named.
fn files_named(tree: &Tree, sol: u32, stem: &str) -> Vec<FoundFile> {
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

/// Finds products in the indices of all volumes. A volume whose sols are all older than the newest by `relist_sols` is
/// closed: its index is not asked for again.
pub(super) fn by_index(
    products: &Products,
    crawl: &mut Crawl<'_>,
    question: Question<'_>,
    relist_sols: u32,
) -> Result<Catalog, StageError> {
    let mut volumes = Vec::new();
    for tree in products.layout.layouts.iter().flatten() {
        let entries = crawl.folder(&tree.root)?.unwrap_or_default();
        let here = entries
            .iter()
            .filter(|entry| entry.folder && tree.is_volume(&entry.name));
        volumes.extend(here.map(|volume| format!("{}/{}", tree.root, volume.name)));
    }
    let tables: Vec<String> = volumes
        .iter()
        .map(|volume| format!("{volume}/INDEX/{}", INDEX[1]))
        .collect();
    let open: Vec<String> = tables
        .iter()
        .filter(|path| {
            !(is_whole(crawl.pages, path) && crawl.pages.state(path).is_some_and(|page| page.settled))
        })
        .cloned()
        .collect();
    for table in changed(crawl, &open)? {
        let found = index_of(crawl, &table.path, &table.bytes)?;
        keep(crawl.pages, &table.path, table.validators, &found);
    }
    let newest = tables
        .iter()
        .filter_map(|path| last_sol(crawl.pages, path))
        .max()
        .unwrap_or(0);
    for path in &tables {
        if last_sol(crawl.pages, path).is_some_and(|last| newest.saturating_sub(last) >= relist_sols) {
            crawl.pages.change(path, |page| page.settled = true);
        }
    }
    Ok(catalog(crawl.pages, &tables, question))
}

/// Returns the products of one volume, by sol.
fn index_of(crawl: &mut Crawl<'_>, path: &str, table: &[u8]) -> Result<BySol, StageError> {
    let bad = |error: IndexError| unreadable(path, &error.to_string());
    let volume = path.rsplit_once("/INDEX/").map_or("", |(volume, _)| volume);
    let label = format!("{volume}/INDEX/{}", INDEX[0]);
    let label = changed(crawl, &[label])?
        .pop()
        .map(|label| label.bytes)
        .unwrap_or_default();
    let index = Index::from_label(&label).map_err(bad)?;
    by_rows(&index, volume, table).map_err(bad)
}

/// Returns the products that the rows of an index name: label and pixels of each.
pub(super) fn by_rows(index: &Index, volume: &str, table: &[u8]) -> Result<BySol, IndexError> {
    let mut found = BySol::new();
    for row in index.rows(table) {
        let location = row?.location();
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

/// A file that was downloaded.
struct DownloadedFile {
    path: String,
    bytes: Vec<u8>,
    validators: Validators,
}

/// Downloads tables, sorted by path. Tables that are unchanged since they were kept are left out.
fn changed(crawl: &mut Crawl<'_>, paths: &[String]) -> Result<Vec<DownloadedFile>, StageError> {
    for path in paths {
        if !is_whole(crawl.pages, path) {
            crawl.pages.forget(std::slice::from_ref(path));
        }
    }
    let wants = paths
        .iter()
        .map(|path| crawl.want(path, path, MAX_TABLE_BYTES))
        .collect::<Result<Vec<_>, StageError>>()?;
    let mut tables = Vec::new();
    crawl
        .client
        .get_all(crawl.ctx.cancel, &wants, &mut |index, answer| {
            match answer? {
                Answer::Whole {
                    bytes, validators, ..
                } => tables.push(DownloadedFile {
                    path: paths[index].clone(),
                    bytes,
                    validators,
                }),
                Answer::Unchanged => {}
                Answer::Absent { .. } => {
                    return Err(StageError::new(format!("the archive has no `{}`", paths[index]))
                        .cause(format!("asked at {}", crawl.bases.join(", ")))
                        .hint("find products by `discover = \"listing\"`, or set `base` of the archive"));
                }
            }
            Ok(())
        })?;
    tables.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(tables)
}

/// Keeps the products that a table names, sol by sol, then the state of the table.
fn keep(pages: &mut Pages, path: &str, validators: Validators, found: &BySol) {
    let start = format!("{path}{OF_SOL}");
    let before: Vec<String> = pages.below(&start).map(|(path, _)| path.to_owned()).collect();
    let now: BTreeSet<String> = found.keys().map(|sol| of_sol(path, *sol)).collect();
    let vanished: Vec<String> = before.into_iter().filter(|path| !now.contains(path)).collect();
    pages.forget(&vanished);
    for (sol, files) in found {
        pages.put(&of_sol(path, *sol), PageState::default(), Some(files));
    }
    let state = PageState {
        validators,
        ..PageState::default()
    };
    pages.put::<BySol>(path, state, None);
}

fn of_sol(path: &str, sol: u32) -> String {
    format!("{path}{OF_SOL}{sol:010}")
}

/// Returns the sols that a table names, as they were kept.
fn sols_of<'a>(pages: &'a Pages, start: &'a str) -> impl Iterator<Item = u32> + 'a {
    pages
        .below(start)
        .filter_map(|(path, _)| path.rsplit_once(OF_SOL)?.1.parse().ok())
}

fn last_sol(pages: &Pages, path: &str) -> Option<u32> {
    sols_of(pages, &format!("{path}{OF_SOL}")).max()
}

/// Whether all pages of a table are still kept.
fn is_whole(pages: &Pages, path: &str) -> bool {
    let start = format!("{path}{OF_SOL}");
    pages.state(path).is_some() && pages.below(&start).all(|(path, _)| pages.state(path).is_some())
}

/// Returns the catalog of the sols that tables name.
fn catalog(pages: &Pages, tables: &[String], question: Question<'_>) -> Catalog {
    let mut listings: BTreeMap<u32, Vec<String>> = BTreeMap::new();
    for path in tables {
        for sol in sols_of(pages, &format!("{path}{OF_SOL}")) {
            listings.entry(sol).or_default().push(of_sol(path, sol));
        }
    }
    let present: BTreeSet<u32> = listings.keys().copied().collect();
    let chosen = question.sols.choose(&present);
    listings.retain(|sol, _| chosen.contains(sol));
    Catalog {
        sols: listings
            .into_iter()
            .map(|(sol, paths)| (sol, SolListing::Pages(paths)))
            .collect(),
        present,
    }
}

/// Returns the files that a table names for a sol. `None` if they are lost.
pub(super) fn files_of(pages: &Pages, path: &str) -> Option<Vec<FoundFile>> {
    pages.content(path)
}

fn unreadable(path: &str, cause: &str) -> StageError {
    StageError::new(format!("`{path}` cannot be read"))
        .cause(cause)
        .hint("find products by `discover = \"listing\"`")
}

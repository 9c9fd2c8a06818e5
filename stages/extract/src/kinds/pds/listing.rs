//! Products found by folder pages, sol by sol.

use std::collections::{BTreeMap, BTreeSet};

use marf_stage::StageError;

use super::layout::Tree;
use super::products::{FoundFile, Products};
use crate::archive::extension;
use crate::remote::catalog::Catalog;
use crate::remote::crawl::{Crawl, Folder};
use crate::sols::Sols;

/// A folder of products of one sol.
struct SolFolder<'a> {
    tree: &'a Tree,
    sol: u32,
    path: String,
}

/// Finds the products of the sols asked for. Sols younger than the newest by less than `relist_sols` are listed again.
///
/// # Errors
/// A server that cannot be asked, an archive without sols, the wish to stop.
pub(super) fn by_listing(
    products: &Products,
    crawl: &Crawl<'_>,
    sols: &Sols,
    relist_sols: u32,
) -> Result<Catalog, StageError> {
    let folders = sol_folders(products, crawl)?;
    let present: BTreeSet<u32> = folders.iter().map(|folder| folder.sol).collect();
    let newest = present.last().copied().unwrap_or(0);
    let chosen = sols.choose(&present);
    let folders: Vec<SolFolder<'_>> = folders
        .into_iter()
        .filter(|folder| chosen.contains(&folder.sol))
        .collect();
    let asked: Vec<Folder> = folders
        .iter()
        .map(|folder| Folder {
            path: folder.path.clone(),
            settled: newest.saturating_sub(folder.sol) >= relist_sols,
        })
        .collect();
    let mut found: BTreeMap<u32, Vec<FoundFile>> = BTreeMap::new();
    for (folder, entries) in folders.iter().zip(crawl.folders(&asked)?) {
        let takes = |name: &str| folder.tree.takes.contains(&extension(name).as_str());
        let entries = entries
            .into_iter()
            .flatten()
            .filter(|entry| !entry.folder && takes(&entry.name));
        found
            .entry(folder.sol)
            .or_default()
            .extend(entries.map(|entry| FoundFile {
                folder: folder.path.clone(),
                name: entry.name,
                modified: entry.modified,
            }));
    }
    products.catalog(found, present)
}

/// Returns the folders of all sols, in the first layout that is there.
fn sol_folders<'a>(products: &'a Products, crawl: &Crawl<'_>) -> Result<Vec<SolFolder<'a>>, StageError> {
    for layout in &products.layout.layouts {
        let mut folders = Vec::new();
        let mut there = true;
        for tree in layout {
            match roots(crawl, tree)? {
                Some(roots) => folders.extend(sols_in(crawl, tree, &roots)?),
                None => there = false,
            }
        }
        if there && !folders.is_empty() {
            return Ok(folders);
        }
    }
    let roots: Vec<&str> = products
        .layout
        .layouts
        .iter()
        .flatten()
        .map(|tree| tree.root.as_str())
        .collect();
    Err(StageError::new(format!("the archive has no sols in `{}`", roots.join("`, `")))
            .cause(format!("asked at {}", products.bases.join(", ")))
            .hint("the archive may have moved: set `base` of the archive to the folder that holds `mars2020/` and `msl/`"))
}

/// Returns the folders that hold sols: the root, or the places in its volumes. `None`: the root is not there.
fn roots(crawl: &Crawl<'_>, tree: &Tree) -> Result<Option<Vec<String>>, StageError> {
    if tree.volumes.is_none() {
        return Ok(Some(vec![tree.root.clone()]));
    }
    let Some(entries) = crawl.folder(&tree.root)? else {
        return Ok(None);
    };
    let volumes = entries
        .into_iter()
        .filter(|entry| entry.folder && tree.is_volume(&entry.name));
    Ok(Some(
        volumes
            .map(|volume| format!("{}/{}/{}", tree.root, volume.name, tree.below_volume))
            .collect(),
    ))
}

fn sols_in<'a>(
    crawl: &Crawl<'_>,
    tree: &'a Tree,
    roots: &[String],
) -> Result<Vec<SolFolder<'a>>, StageError> {
    // A closed volume gets no new sols, but which are closed is not told: each is asked for, with its validators.
    let asked: Vec<Folder> = roots
        .iter()
        .map(|root| Folder {
            path: root.clone(),
            settled: false,
        })
        .collect();
    let mut folders = Vec::new();
    for (root, entries) in roots.iter().zip(crawl.folders(&asked)?) {
        for entry in entries.into_iter().flatten().filter(|entry| entry.folder) {
            folders.extend(tree.sol_of(&entry.name).map(|sol| SolFolder {
                tree,
                sol,
                path: tree.products(root, &entry.name),
            }));
        }
    }
    Ok(folders)
}

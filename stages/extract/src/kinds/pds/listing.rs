//! Products found by folder pages, sol by sol.
//!
//! Unchanged folders are not requested again:
//! - A sol that is older than the newest by `relist_sols` and wholly pinned is not requested at all.
//! - Mars 2020 keeps products deep below the folder of a sol, whose date does not show them. But a collection lists
//!   all its members in an inventory next to its `sol` folder. While the page with both shows the same dates, neither
//!   a sol nor a product of a known sol was released. This page is the only request for a tree.
//! - Curiosity keeps products in the folder of the sol. The page of all sols shows its date, which changes with any
//!   name in it. With volumes this takes two requests: the page of all volumes shows a new volume, and the page of
//!   the newest volume shows a new sol. A volume with only old sols is closed and not requested.
//!
//! A date counts when it is [`RELEASE`] old: while a release is being copied, its dates may be there before its files. Where
//! no inventory is shown, each young sol is asked for at each run, a page a tree, as many at once as the host allows.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, SystemTime};

use marf_cache::digest_of;
use marf_pds::listing::Entry;
use marf_stage::StageError;

use super::layout::Tree;
use super::products::{FoundFile, Products};
use crate::archive::extension;
use crate::remote::catalog::{Catalog, Question, SolListing};
use crate::remote::crawl::{Crawl, Folder};
use crate::remote::pages::Pages;

/// Age from which a date covers all files of its release. Dates are in the server's zone.
const RELEASE: Duration = Duration::from_secs(2 * 24 * 3600);

/// A folder that holds sols.
struct Root<'a> {
    tree: &'a Tree,
    path: String,
    /// Version of everything below, if the page above reports it.
    version: Option<String>,
}

/// A folder of products of one sol.
struct SolFolder {
    sol: u32,
    path: String,
    version: Option<String>,
}

/// Finds the products of the sols asked for. Sols younger than the newest by less than `relist_sols` may be listed again.
///
/// # Errors
/// A server that cannot be asked, an archive without sols, the wish to stop.
pub(super) fn by_listing(
    products: &Products,
    crawl: &mut Crawl<'_>,
    question: Question<'_>,
    relist_sols: u32,
) -> Result<Catalog, StageError> {
    let folders = sol_folders(products, crawl, relist_sols)?;
    let present: BTreeSet<u32> = folders.iter().map(|folder| folder.sol).collect();
    let newest = present.last().copied().unwrap_or(0);
    let settled = |sol: u32| newest.saturating_sub(sol) >= relist_sols;
    let mut sols: BTreeMap<u32, SolListing> = BTreeMap::new();
    for sol in question.sols.choose(&present) {
        let pinned = settled(sol) && (question.is_pinned)(sol);
        sols.insert(
            sol,
            if pinned {
                SolListing::Pinned
            } else {
                SolListing::Pages(Vec::new())
            },
        );
    }
    let mut asked = Vec::new();
    for folder in folders {
        if let Some(SolListing::Pages(paths)) = sols.get_mut(&folder.sol) {
            paths.push(folder.path.clone());
            asked.push(Folder {
                settled: settled(folder.sol),
                path: folder.path,
                version: folder.version,
            });
        }
    }
    crawl.folders(&asked)?;
    Ok(Catalog { sols, present })
}

/// Returns the files that the page of a folder names. `None` if the page is lost.
pub(super) fn files_of(products: &Products, pages: &Pages, path: &str) -> Option<Vec<FoundFile>> {
    if pages.state(path)?.content.is_none() {
        return Some(Vec::new());
    }
    let entries: Vec<Entry> = pages.content(path)?;
    let mut trees = products.layout.layouts.iter().flatten();
    let below = |tree: &&Tree| {
        path.strip_prefix(&tree.root)
            .is_some_and(|rest| rest.starts_with('/'))
    };
    let takes = trees.find(below)?.takes;
    let taken = entries
        .into_iter()
        .filter(|entry| !entry.folder && takes.contains(&extension(&entry.name).as_str()));
    let found = taken.map(|entry| FoundFile {
        folder: path.to_owned(),
        name: entry.name,
        modified: entry.modified,
    });
    Some(found.collect())
}

/// Returns the folders of all sols, in the first layout that is there.
fn sol_folders(
    products: &Products,
    crawl: &mut Crawl<'_>,
    relist_sols: u32,
) -> Result<Vec<SolFolder>, StageError> {
    for layout in &products.layout.layouts {
        let Some(roots) = roots(crawl, layout)? else {
            continue;
        };
        let folders = sols_in(crawl, &roots)?;
        if !folders.is_empty() {
            close_volumes(crawl.pages, &roots, &folders, relist_sols);
            return Ok(folders);
        }
    }
    let trees = products.layout.layouts.iter().flatten();
    let roots: Vec<&str> = trees.map(|tree| tree.root.as_str()).collect();
    Err(StageError::new(format!("the archive has no sols in `{}`", roots.join("`, `")))
            .cause(format!("asked at {}", products.bases.join(", ")))
            .hint("the archive may have moved: set `base` of the archive to the folder that holds `mars2020/` and `msl/`"))
}

/// Returns the folders that hold sols: the roots of trees, or the places in their volumes. `None`: a root is not there.
fn roots<'a>(crawl: &mut Crawl<'_>, layout: &'a [Tree]) -> Result<Option<Vec<Root<'a>>>, StageError> {
    let above: Vec<Folder> = layout.iter().filter_map(collection).map(Folder::young).collect();
    crawl.hints(&above)?;
    let mut roots = Vec::new();
    for tree in layout {
        if tree.volumes.is_none() {
            let entries = collection(tree).and_then(|path| crawl.entries(path));
            roots.push(Root {
                tree,
                path: tree.root.clone(),
                version: entries.and_then(|entries| released(&entries)),
            });
            continue;
        }
        let Some(entries) = crawl.folder(&tree.root)? else {
            return Ok(None);
        };
        let volumes = entries
            .into_iter()
            .filter(|entry| entry.folder && tree.is_volume(&entry.name));
        roots.extend(volumes.map(|volume| Root {
            tree,
            path: format!("{}/{}/{}", tree.root, volume.name, tree.below_volume),
            version: None,
        }));
    }
    Ok(Some(roots))
}

/// Returns the folder of the collection of a tree, if its page shows changes in the tree.
pub(super) fn collection(tree: &Tree) -> Option<&str> {
    let deep = tree.volumes.is_none() && !tree.below_sol.is_empty();
    tree.root
        .rsplit_once('/')
        .filter(|_| deep)
        .map(|(folder, _)| folder)
}

/// Returns the version of a collection by the page of its folder: the dates of its inventory and of its other entries.
fn released(entries: &[Entry]) -> Option<String> {
    let shown =
        entries.iter().any(is_inventory) && entries.iter().all(|entry| is_past(entry.modified.as_deref()));
    let seen: Vec<(&str, Option<&str>)> = entries
        .iter()
        .map(|entry| (entry.name.as_str(), entry.modified.as_deref()))
        .collect();
    shown.then(|| digest_of(&seen).to_string())
}

/// Whether an entry is the inventory of a collection.
pub(super) fn is_inventory(entry: &Entry) -> bool {
    !entry.folder && entry.name.starts_with("collection") && entry.name.ends_with("inventory.csv")
}

/// Whether a date of a page, `YYYY-MM-DDTHH:MM`, is so old that all files of that date are present.
fn is_past(modified: Option<&str>) -> bool {
    let time = modified.and_then(|date| humantime::parse_rfc3339(&format!("{date}:00Z")).ok());
    let age = time.and_then(|time| SystemTime::now().duration_since(time).ok());
    age.is_some_and(|age| age >= RELEASE)
}

fn sols_in(crawl: &mut Crawl<'_>, roots: &[Root<'_>]) -> Result<Vec<SolFolder>, StageError> {
    let folder = |root: &Root<'_>| Folder {
        path: root.path.clone(),
        settled: is_closed(crawl.pages, root),
        version: root.version.clone(),
    };
    let asked: Vec<Folder> = roots.iter().map(folder).collect();
    crawl.folders(&asked)?;
    let mut folders = Vec::new();
    for root in roots {
        let entries = crawl.entries(&root.path);
        for entry in entries.into_iter().flatten().filter(|entry| entry.folder) {
            let Some(sol) = root.tree.sol_of(&entry.name) else {
                continue;
            };
            let dated = root.tree.below_sol.is_empty() && is_past(entry.modified.as_deref());
            folders.push(SolFolder {
                sol,
                path: root.tree.products(&root.path, &entry.name),
                version: root.version.clone().or(entry.modified.filter(|_| dated)),
            });
        }
    }
    Ok(folders)
}

/// Whether a volume was closed when it was last listed.
fn is_closed(pages: &Pages, root: &Root<'_>) -> bool {
    root.tree.volumes.is_some() && pages.state(&root.path).is_some_and(|page| page.settled)
}

/// Keeps that volumes of old sols only get no new ones.
fn close_volumes(pages: &mut Pages, roots: &[Root<'_>], folders: &[SolFolder], relist_sols: u32) {
    let newest = folders.iter().map(|folder| folder.sol).max().unwrap_or(0);
    for root in roots.iter().filter(|root| root.tree.volumes.is_some()) {
        let start = format!("{}/", root.path);
        let below = |folder: &&SolFolder| folder.path.starts_with(&start);
        let last = folders.iter().filter(below).map(|folder| folder.sol).max();
        if last.is_some_and(|last| newest.saturating_sub(last) >= relist_sols) {
            pages.change(&root.path, |page| page.settled = true);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(name: &str, modified: Option<&str>) -> Entry {
        Entry {
            name: name.to_owned(),
            folder: !name.contains('.'),
            modified: modified.map(str::to_owned),
        }
    }

    #[test]
    fn a_collection_has_a_version_where_its_inventory_and_all_dates_are_shown_and_old() {
        let old = Some("2022-03-01T10:20");
        let inventory = entry("collection_data_inventory.csv", old);
        let page = [inventory.clone(), entry("sol", old)];
        let version = released(&page).unwrap();
        assert_eq!(released(&page), Some(version.clone()));
        let later = [inventory.clone(), entry("sol", Some("2022-03-02T10:20"))];
        assert_ne!(released(&later), Some(version));
        assert_eq!(released(&page[1..]), None, "no inventory");
        assert_eq!(
            released(&[inventory.clone(), entry("sol", None)]),
            None,
            "no date"
        );
        let now = humantime::format_rfc3339_seconds(SystemTime::now()).to_string();
        let fresh = entry("sol", Some(&now[..16]));
        assert_eq!(released(&[inventory.clone(), fresh]), None, "a release under way");
        assert_eq!(
            released(&[inventory, entry("sol", Some("2999-01-01T00:00"))]),
            None
        );
    }

    #[test]
    fn what_is_no_date_is_not_past() {
        for date in [
            "",
            "yesterday",
            "2022-03-01",
            "2022-13-01T10:20",
            "0000-00-00T00:00",
        ] {
            assert!(!is_past(Some(date)), "{date}");
        }
    }
}

//! One page of each kind that the crawl reads, and the products of one sol.

use std::collections::{BTreeMap, BTreeSet};

use marf_pds::ProductName;
use marf_pds::listing::{self, Entry};
use marf_stage::{Sols, StageError};

use super::layout::Tree;
use super::listing::{collection, is_inventory};
use super::products::{FoundFile, Products};
use crate::archive::{extension, stem};
use crate::check::{Absence, Checkup, Question, Reading};
use crate::remote::catalog::ListedSol;
use crate::remote::crawl::{MAX_PAGE_BYTES, urls};

/// Most sols, and most volumes, that are asked for until one has what is looked for.
const TRIED: usize = 3;

/// A folder of sols that has been read.
struct ReadRoot<'a> {
    tree: &'a Tree,
    path: String,
    /// The folders of sols.
    sols: BTreeMap<u32, String>,
}

/// Asks for the pages between the root and the products of one sol.
pub(super) fn by_listing(
    products: &Products,
    checkup: &mut Checkup<'_>,
    sols: &Sols,
) -> Result<Option<ListedSol>, StageError> {
    let layouts = &products.layout.layouts;
    for (index, layout) in layouts.iter().enumerate() {
        let is_last = index + 1 == layouts.len();
        let absence = if is_last { Absence::Differs } else { Absence::Usual };
        let mut roots = Vec::new();
        for tree in layout {
            roots.extend(root(products, checkup, tree, absence)?);
        }
        if !roots.is_empty() {
            return one_sol(products, checkup, &roots, sols);
        }
        if !checkup.is_empty() {
            break;
        }
    }
    Ok(None)
}

/// Returns the sols to look at, the newest of those asked for first.
fn tried(sols: &Sols, present: &BTreeSet<u32>) -> Vec<u32> {
    let asked = sols.choose(present);
    let others = present.iter().rev().filter(|sol| !asked.contains(sol));
    asked.iter().rev().chain(others).copied().take(TRIED).collect()
}

/// Asks for the pages of the products of a sol, and of an earlier one where they name no picture.
fn one_sol(
    products: &Products,
    checkup: &mut Checkup<'_>,
    roots: &[ReadRoot<'_>],
    sols: &Sols,
) -> Result<Option<ListedSol>, StageError> {
    let present = roots.iter().flat_map(|root| root.sols.keys().copied()).collect();
    for sol in tried(sols, &present) {
        let mut found = Vec::new();
        for root in roots {
            let Some(folder) = root.sols.get(&sol) else {
                continue;
            };
            let path = root.tree.products(&root.path, folder);
            let question = page(products, &format!("page of sol {sol}"), &path, Absence::Usual)?;
            let files = checkup.ask(question, |bytes| files_of(root.tree, &path, bytes))?;
            found.extend(files.unwrap_or_default());
        }
        let files = products.taken(sol, found)?;
        if !files.files.is_empty() {
            return Ok(Some(ListedSol { sol, files }));
        }
    }
    Ok(None)
}

/// Asks for the pages down to the folder of sols.
fn root<'a>(
    products: &Products,
    checkup: &mut Checkup<'_>,
    tree: &'a Tree,
    absence: Absence,
) -> Result<Option<ReadRoot<'a>>, StageError> {
    let (paths, absence) = match tree.volumes {
        Some(_) => {
            let volumes = volumes(products, checkup, tree, absence)?;
            let below = volumes
                .iter()
                .rev()
                .map(|volume| format!("{volume}/{}", tree.below_volume));
            (below.take(TRIED).collect(), Absence::Usual)
        }
        None => {
            if let Some(path) = collection(tree) {
                let question = page(products, "page of the collection", path, Absence::Usual)?;
                checkup.ask(question, |bytes| collection_page(path, bytes))?;
            }
            (vec![tree.root.clone()], absence)
        }
    };
    for path in paths {
        let question = page(products, "page of sols", &path, absence)?;
        if let Some(sols) = checkup.ask(question, |bytes| sols_of(tree, &path, bytes))? {
            return Ok(Some(ReadRoot { tree, path, sols }));
        }
    }
    Ok(None)
}

/// Asks for the page of volumes. Returns their paths, the newest last.
fn volumes(
    products: &Products,
    checkup: &mut Checkup<'_>,
    tree: &Tree,
    absence: Absence,
) -> Result<Vec<String>, StageError> {
    let path = &tree.root;
    let question = page(products, "page of volumes", path, absence)?;
    let read = |bytes: &[u8]| {
        let entries = entries(bytes)?;
        let volumes = entries
            .iter()
            .filter(|entry| entry.folder && tree.is_volume(&entry.name));
        let volumes: Vec<String> = volumes.map(|entry| format!("{path}/{}", entry.name)).collect();
        let Some(last) = volumes.last() else {
            let shape = tree.volumes.unwrap_or_default();
            return Err(format!(
                "`{path}`: none of its {} entries is named like volume `{shape}`",
                entries.len()
            ));
        };
        let found = format!("`{path}`: {} volumes, the newest `{last}`", volumes.len());
        Ok(Reading::new(volumes, found))
    };
    Ok(checkup.ask(question, read)?.unwrap_or_default())
}

fn collection_page(path: &str, bytes: &[u8]) -> Result<Reading<()>, String> {
    let entries = entries(bytes)?;
    let shown = if entries.iter().any(is_inventory) {
        "it shows whether anything was released"
    } else {
        "it names no inventory, so that each run asks for every young sol"
    };
    Ok(Reading::new(
        (),
        format!("`{path}`: {} entries, {shown}", entries.len()),
    ))
}

fn sols_of(tree: &Tree, path: &str, bytes: &[u8]) -> Result<Reading<BTreeMap<u32, String>>, String> {
    let entries = entries(bytes)?;
    let folders = entries.iter().filter(|entry| entry.folder);
    let sols: BTreeMap<u32, String> = folders
        .filter_map(|entry| Some((tree.sol_of(&entry.name)?, entry.name.clone())))
        .collect();
    let (Some(first), Some(last)) = (sols.keys().next(), sols.keys().next_back()) else {
        let (start, digits) = tree.sol;
        let like = format!("{start}{:0digits$}", 12);
        return Err(format!(
            "`{path}`: none of its {} entries is a folder like `{like}`",
            entries.len()
        ));
    };
    let found = format!("`{path}`: {} sols from {first} to {last}", sols.len());
    Ok(Reading::new(sols, found))
}

fn files_of(tree: &Tree, path: &str, bytes: &[u8]) -> Result<Reading<Vec<FoundFile>>, String> {
    let entries = entries(bytes)?;
    let total = entries.len();
    let is_taken = |entry: &Entry| !entry.folder && tree.takes.contains(&extension(&entry.name).as_str());
    let taken: Vec<Entry> = entries.into_iter().filter(is_taken).collect();
    let named = taken
        .iter()
        .filter(|entry| ProductName::read(stem(&entry.name)).is_some())
        .count();
    let mut differs = Vec::new();
    if total > 0 && taken.is_empty() {
        differs.push(format!(
            "`{path}`: none of its {total} entries ends in .{}",
            tree.takes.join(" or .")
        ));
    } else if let Some(first) = taken.first().filter(|_| named == 0) {
        differs.push(format!(
            "`{path}`: none of its names follows the scheme of the mission, as `{}`",
            first.name
        ));
    }
    let found = format!("`{path}`: {named} files named as products");
    let file = |entry: Entry| FoundFile {
        folder: path.to_owned(),
        name: entry.name,
        modified: entry.modified,
    };
    Ok(Reading {
        value: taken.into_iter().map(file).collect(),
        found,
        differs,
    })
}

/// Reads a folder page, which has to show dates: they are how a run knows what changed.
fn entries(bytes: &[u8]) -> Result<Vec<Entry>, String> {
    let entries = listing::read(bytes).map_err(|error| error.to_string())?;
    if !entries.is_empty() && entries.iter().all(|entry| entry.modified.is_none()) {
        return Err("a folder listing that shows no dates".to_owned());
    }
    Ok(entries)
}

fn page(products: &Products, what: &str, path: &str, absence: Absence) -> Result<Question, StageError> {
    Ok(Question {
        what: what.to_owned(),
        urls: urls(&products.bases, &format!("{path}/"))?,
        cap_bytes: MAX_PAGE_BYTES,
        absence,
    })
}

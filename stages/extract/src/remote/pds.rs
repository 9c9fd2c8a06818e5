//! The Planetary Data System: folder pages, inventories or index tables to offers.

use std::collections::{BTreeMap, BTreeSet};

use marf_pds::{ProductName, join_key};
use marf_stage::{Ctx, StageError};

use super::crawl::{Crawl, Folder, urls};
use super::offer::{Offer, Offered, Offers, Survey};
use super::trees::{Holding, Tree, exposure};
use crate::archive::{extension, stem};
use crate::net::Client;
use crate::params::Discover;
use crate::sols::Sols;

/// Largest files by extension; products of these cameras have at most 20 MB.
const MAX_IMG_BYTES: u64 = 64 << 20;
const MAX_PNG_BYTES: u64 = 32 << 20;
const MAX_LABEL_BYTES: u64 = 2 << 20;

/// One camera of the archive.
pub(crate) struct Pds {
    /// Where its products lie.
    pub holding: Holding,
    /// How they are found.
    pub discover: Discover,
    /// Where the archive lies.
    pub bases: Vec<String>,
    /// Sols younger than the newest by less are listed again.
    pub relist_sols: u32,
}

/// A file that is there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Found {
    /// Its folder, below the base.
    pub folder: String,
    /// Its name.
    pub name: String,
    /// When it was last changed.
    pub modified: Option<String>,
}

/// A folder of products of one sol.
struct SolFolder<'a> {
    tree: &'a Tree,
    sol: u32,
    path: String,
}

impl Offers for Pds {
    fn survey(&self, ctx: &Ctx<'_>, client: &Client, sols: &Sols) -> Result<Survey, StageError> {
        let crawl = Crawl {
            ctx,
            client,
            bases: &self.bases,
        };
        match self.discover {
            Discover::Listing => self.by_listing(&crawl, sols),
            Discover::Inventory => super::tables::by_inventory(self, &crawl, sols),
            Discover::Index => super::tables::by_index(self, &crawl, sols),
        }
    }
}

impl Pds {
    fn by_listing(&self, crawl: &Crawl<'_>, sols: &Sols) -> Result<Survey, StageError> {
        let folders = self.sol_folders(crawl)?;
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
                settled: self.is_settled(folder.sol, newest),
            })
            .collect();
        let mut found: BTreeMap<u32, Vec<Found>> = BTreeMap::new();
        for (folder, entries) in folders.iter().zip(crawl.folders(&asked)?) {
            let takes = |name: &str| folder.tree.takes.contains(&extension(name).as_str());
            let entries = entries
                .into_iter()
                .flatten()
                .filter(|entry| !entry.folder && takes(&entry.name));
            found
                .entry(folder.sol)
                .or_default()
                .extend(entries.map(|entry| Found {
                    folder: folder.path.clone(),
                    name: entry.name,
                    modified: entry.modified,
                }));
        }
        Ok(Survey {
            offers: self.offers(found)?,
            present,
        })
    }

    /// Tells whether a sol is so much older than the newest that nothing more arrives for it.
    pub fn is_settled(&self, sol: u32, newest: u32) -> bool {
        newest.saturating_sub(sol) >= self.relist_sols
    }

    /// Finds the folders of all sols: the first layout that is there.
    fn sol_folders(&self, crawl: &Crawl<'_>) -> Result<Vec<SolFolder<'_>>, StageError> {
        for layout in &self.holding.layouts {
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
        let roots: Vec<&str> = self
            .holding
            .layouts
            .iter()
            .flatten()
            .map(|tree| tree.root.as_str())
            .collect();
        Err(StageError::new(format!("the archive has no sols in `{}`", roots.join("`, `")))
            .cause(format!("asked at {}", self.bases.join(", ")))
            .hint("the archive may have moved: set `base` of the archive to the folder that holds `mars2020/` and `msl/`"))
    }

    /// Sorts what is there into offers.
    ///
    /// # Errors
    /// A base that is no address.
    pub fn offers(&self, found: BTreeMap<u32, Vec<Found>>) -> Result<BTreeMap<u32, Offer>, StageError> {
        let mut offers = BTreeMap::new();
        for (sol, files) in found {
            let offer = self.offer(sol, files)?;
            if !offer.is_empty() {
                offers.insert(sol, offer);
            }
        }
        Ok(offers)
    }

    fn offer(&self, sol: u32, files: Vec<Found>) -> Result<Offer, StageError> {
        let mut offer = Offer::default();
        let mut photos: Vec<(ProductName, usize, Found)> = Vec::new();
        let mut labels: BTreeMap<String, Vec<Found>> = BTreeMap::new();
        for file in files {
            let name = ProductName::read(stem(&file.name));
            let is_label = matches!(extension(&file.name).as_str(), "xml" | "lbl");
            match name.ok_or("its name follows no scheme of the mission".to_owned()) {
                Ok(name) if is_label => labels.entry(join_key(&name.id)).or_default().push(file),
                Ok(name) => match self.judge(&name, sol) {
                    Ok(rank) => photos.push((name, rank, file)),
                    Err(reason) => drop(offer.left_out.insert(file.name, reason)),
                },
                Err(_) if is_label => {}
                Err(reason) => drop(offer.left_out.insert(file.name, reason)),
            }
        }
        let all = self.holding.types.iter().any(|kind| kind == "*");
        for (name, file) in best(photos, all, &mut offer.left_out) {
            let label = labels
                .get(&join_key(&name.id))
                .and_then(|labels| labels.iter().max_by_key(|label| &label.name));
            for file in label.into_iter().chain([&file]) {
                offer.files.insert(file.name.clone(), self.offered(file)?);
            }
        }
        Ok(offer)
    }

    fn judge(&self, name: &ProductName, sol: u32) -> Result<usize, String> {
        if !self.holding.codes.contains(&name.instrument.as_str()) {
            return Err(format!("of another camera ({})", name.instrument));
        }
        match name.sol {
            Some(other) if other != sol => Err(format!("its name says sol {other}, its folder sol {sol}")),
            _ => self.holding.rank(name),
        }
    }

    fn offered(&self, file: &Found) -> Result<Offered, StageError> {
        Ok(Offered {
            urls: urls(&self.bases, &format!("{}/{}", file.folder, file.name))?,
            cap_bytes: match extension(&file.name).as_str() {
                "img" => MAX_IMG_BYTES,
                "xml" | "lbl" => MAX_LABEL_BYTES,
                _ => MAX_PNG_BYTES,
            },
            listed: file.modified.clone(),
            bytes: None,
        })
    }
}

/// Of each exposure the preferred product, of each product the newest version.
fn best(
    photos: Vec<(ProductName, usize, Found)>,
    all: bool,
    left_out: &mut BTreeMap<String, String>,
) -> Vec<(ProductName, Found)> {
    let mut groups: BTreeMap<String, Vec<(ProductName, usize, Found)>> = BTreeMap::new();
    for photo in photos {
        let key = if all {
            join_key(&photo.0.id)
        } else {
            exposure(&photo.0)
        };
        groups.entry(key).or_default().push(photo);
    }
    let mut best = Vec::new();
    for (_, mut group) in groups {
        group.sort_by(|a, b| (a.1, &b.0.version, &a.2.name).cmp(&(b.1, &a.0.version, &b.2.name)));
        let mut group = group.into_iter();
        let Some((name, _, file)) = group.next() else {
            continue;
        };
        for (other, _, rest) in group {
            let reason = if join_key(&other.id) == join_key(&name.id) {
                format!("version {} is superseded by {}", other.version, name.version)
            } else {
                format!("of this exposure {} is taken", name.id)
            };
            left_out.insert(rest.name, reason);
        }
        best.push((name, file));
    }
    best
}

/// The folders that hold sols: the root, or the places in its volumes. `None`: the root is not there.
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

//! The photos that the page shows. A million others are not read.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::Digest;
use marf_cache::manifest::{BlockRef, LeafRef, Row};
use marf_scene::PhotoFacts;
use marf_stage::PHOTOS;
use serde::{Serialize, de::DeserializeOwned};

use super::read::Missing;
use super::report::Report;
use super::sets::Set;

/// Most photos of one node that are shown.
const MOST_KEPT: usize = 30;
/// Version of the memos: to be raised when other photos would be drawn from the same set.
const VERSION: u32 = 1;

/// A photo as the manifests know it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PhotoEntry {
    /// Name of the file in its archive.
    pub(super) file: String,
    /// Digest of its thumbnail, or else of the image itself, if the row names one.
    pub(super) image: Option<Digest>,
}

/// Address of a photo: its sol, and its id.
pub(super) type Spot = (u32, String);

/// Photos by id, and what of the sets could not be read.
#[derive(Debug, Default)]
pub(super) struct PhotoIndex {
    entries: BTreeMap<String, PhotoEntry>,
    missing: Vec<Missing>,
}

impl PhotoIndex {
    /// Finds photos in the sets of a run. One that is not in its sol (the twin of a duplicate may be of any) is looked
    /// for in all sols of the sources.
    pub(super) fn new<'a>(
        sets: impl Iterator<Item = Result<Set<'a>, Missing>>,
        wanted: impl Iterator<Item = Spot>,
    ) -> Self {
        let mut index = Self::default();
        let sets: Vec<_> = sets
            .filter_map(|set| set.map_err(|missing| index.miss(missing)).ok())
            .collect();
        let mut by_shard: BTreeMap<u32, BTreeSet<String>> = BTreeMap::new();
        for (shard, id) in wanted {
            by_shard.entry(shard).or_default().insert(id);
        }
        let mut elsewhere = BTreeSet::new();
        for (shard, mut ids) in by_shard {
            for set in &sets {
                index.look(set, set.leaves_of(shard), &mut ids);
            }
            elsewhere.append(&mut ids);
        }
        elsewhere.retain(|id| !index.entries.contains_key(id));
        for set in sets.iter().filter(|set| set.is_of_source()) {
            for block in &set.blocks {
                if elsewhere.is_empty() {
                    return index;
                }
                index.look(set, set.leaves(block), &mut elsewhere);
            }
        }
        index
    }

    /// Finds a photo by id.
    pub(super) fn get(&self, id: &str) -> Option<&PhotoEntry> {
        self.entries.get(id)
    }

    /// Parts of manifests that could not be read, and why.
    pub(super) fn missing(&self) -> impl Iterator<Item = &Missing> {
        self.missing.iter()
    }

    /// Keeps the photos of some leaves that are looked for, and takes their ids from `ids`.
    fn look(&mut self, set: &Set<'_>, leaves: Result<Vec<LeafRef>, Missing>, ids: &mut BTreeSet<String>) {
        let leaves = leaves.unwrap_or_else(|missing| {
            self.miss(missing);
            Vec::new()
        });
        for leaf in leaves {
            if ids.is_empty() {
                return;
            }
            match set.photos(&leaf) {
                Ok(rows) => {
                    for row in rows.iter().filter(|row| ids.remove(&row.id)) {
                        self.entries.insert(row.id.clone(), entry(row));
                    }
                }
                Err(missing) => self.miss(missing),
            }
        }
    }

    fn miss(&mut self, missing: Missing) {
        if !self.missing.contains(&missing) {
            self.missing.push(missing);
        }
    }
}

/// The file name falls back to the id where the facts are not those of a photo.
fn entry(row: &Row) -> PhotoEntry {
    let facts = PhotoFacts::from_json(&row.facts).unwrap_or_default();
    let file = if facts.file.is_empty() {
        row.id.clone()
    } else {
        facts.file
    };
    PhotoEntry {
        file,
        // A small photo is its own thumbnail.
        image: row
            .blobs
            .get("thumbnail")
            .or_else(|| row.blobs.get("image"))
            .copied(),
    }
}

/// Names of the nodes whose photos no other node filters further.
pub(super) fn last_photo_nodes<'a>(report: &'a Report<'_>) -> Vec<&'a str> {
    let nodes = report.nodes.iter();
    let with_photos: Vec<_> = nodes.filter(|node| node.digest(PHOTOS).is_some()).collect();
    let consumed: BTreeSet<&str> = with_photos
        .iter()
        .flat_map(|node| report.upstream(node))
        .collect();
    let names = with_photos.iter().map(|node| node.run.name.as_str());
    names.filter(|name| !consumed.contains(name)).collect()
}

/// Photos that pass all filters.
pub(super) struct Kept {
    /// Number of photos.
    pub(super) count: usize,
    /// At most [`MOST_KEPT`] of them, in the order of the set.
    pub(super) shown: Vec<Spot>,
}

/// A photo in the order of the digests of ids. The first few are a sample in which every photo has the same
/// chance, and a new sol changes the sample little.
type Drawn = (Digest, Spot);

impl Kept {
    /// Draws from a set, by what earlier reports have drawn from its blocks.
    pub(super) fn new(report: &Report<'_>, set: &Set<'_>) -> Result<Self, Missing> {
        let mut drawn = Vec::new();
        for block in &set.blocks {
            let key = Digest::from_content(format!("sample {VERSION} {}", block.digest).as_bytes());
            drawn.extend(remembered(report, &key, || sample(set, block))?);
            drawn.sort();
            drawn.truncate(MOST_KEPT);
        }
        let mut shown: Vec<Spot> = drawn.into_iter().map(|(_, spot): Drawn| spot).collect();
        shown.sort();
        Ok(Self {
            count: set.rows() as usize,
            shown,
        })
    }
}

fn sample(set: &Set<'_>, block: &BlockRef) -> Result<Vec<Drawn>, Missing> {
    let mut drawn: Vec<Drawn> = Vec::new();
    for leaf in set.leaves(block)? {
        let rows = set.photos(&leaf)?.into_iter();
        drawn.extend(rows.map(|row| (Digest::from_content(row.id.as_bytes()), (leaf.shard, row.id))));
        drawn.sort();
        drawn.truncate(MOST_KEPT);
    }
    Ok(drawn)
}

/// Returns the result of an earlier report for the same objects, or makes it.
pub(super) fn remembered<T: Serialize + DeserializeOwned>(
    report: &Report<'_>,
    key: &Digest,
    make: impl FnOnce() -> Result<T, Missing>,
) -> Result<T, Missing> {
    let known = report.memos.load(key);
    if let Some(known) = known.and_then(|bytes| serde_json::from_slice(&bytes).ok()) {
        return Ok(known);
    }
    let made = make()?;
    // Strings and finite numbers always serialise. An empty table is made again.
    report
        .memos
        .save(key, &serde_json::to_vec(&made).unwrap_or_default());
    Ok(made)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use marf_cache::manifest::{Leaf, LeafRef, Root};
    use marf_stage::PHOTOS;

    use super::*;
    use crate::fixture::{self, giving, node};

    /// Draws from a set of sols with ten photos each.
    fn drawn(sols: u32) -> BTreeSet<Spot> {
        let mut store = fixture::Store::default();
        let mut leaf = |shard: u32| {
            let ids = (0..10).map(|at| format!("{shard:04}-{at}.jpg"));
            let rows: Vec<Row> = ids.map(|id| fixture::row(&mut store, &id, 9)).collect();
            let rows_here = rows.len() as u32;
            LeafRef {
                shard,
                leaf: store.put(&Leaf::new(rows).unwrap().encode()),
                rows: rows_here,
            }
        };
        let leaves = (0..sols).map(&mut leaf).collect();
        let Ok(root) = Root { leaves }.write(|bytes| Ok::<_, std::convert::Infallible>(store.put(bytes)));
        let nodes = [giving(node("extract", &[]), [(PHOTOS, root)])];
        store.with_report(&nodes, |report| {
            let set = Set::open(report, report.nodes[0], PHOTOS).unwrap().ok().unwrap();
            let kept = Kept::new(report, &set).ok().unwrap();
            assert_eq!(kept.count, 10 * sols as usize);
            kept.shown.into_iter().collect()
        })
    }

    #[test]
    fn few_photos_are_all_shown_and_a_new_sol_changes_few_of_many() {
        assert_eq!(drawn(0).len(), 0);
        assert_eq!(drawn(2).len(), 20);
        let (before, after) = (drawn(100), drawn(101));
        assert_eq!((before.len(), after.len()), (MOST_KEPT, MOST_KEPT));
        assert!(before.difference(&after).count() <= 3);
        // Across both blocks.
        assert!(before.iter().any(|(shard, _)| *shard < 64) && before.iter().any(|(shard, _)| *shard >= 64));
    }
}

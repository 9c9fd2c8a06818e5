use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

use marf_cache::Digest;
use marf_cache::manifest::{Leaf, LeafRef, ManifestError, Row};
use marf_scene::PhotoFacts;
use marf_stage::{PHOTOS, VERDICTS, Verdict};

use super::input::{NodeView, ReportInput};
use super::read::{Missing, not_stored, read, unreadable};
use crate::sets;

/// A photo as the manifests know it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PhotoEntry {
    /// Name of the file in its archive.
    pub(super) file: String,
    /// Digest of its thumbnail, or else of the image itself, if the row names one.
    pub(super) image: Option<Digest>,
}

/// All photos of the run by id, and the ids each node passed on.
#[derive(Debug, Default)]
pub(super) struct PhotoIndex {
    entries: BTreeMap<String, PhotoEntry>,
    ids_by_node: BTreeMap<String, Result<Vec<String>, Missing>>,
}

impl PhotoIndex {
    /// Reads every `photos` output, each leaf once.
    pub(super) fn new(input: &ReportInput<'_>) -> Self {
        let mut index = Self::default();
        let mut leaves: BTreeMap<Digest, Vec<String>> = BTreeMap::new();
        for node in input
            .nodes
            .iter()
            .filter(|node| node.outputs.contains_key(PHOTOS))
        {
            let ids = index.read_node(input, node, &mut leaves);
            index.ids_by_node.insert(node.name.clone(), ids);
        }
        index
    }

    /// Finds a photo by id.
    pub(super) fn get(&self, id: &str) -> Option<&PhotoEntry> {
        self.entries.get(id)
    }

    /// Ids of the photos a node passed on, in the order of the manifest.
    pub(super) fn ids_of(&self, node: &str) -> Option<&Result<Vec<String>, Missing>> {
        self.ids_by_node.get(node)
    }

    /// Manifests that could not be read, and why.
    pub(super) fn missing(&self) -> impl Iterator<Item = &Missing> {
        self.ids_by_node.values().filter_map(|ids| ids.as_ref().err())
    }

    fn read_node(
        &mut self,
        input: &ReportInput<'_>,
        node: &NodeView,
        known: &mut BTreeMap<Digest, Vec<String>>,
    ) -> Result<Vec<String>, Missing> {
        let mut ids = Vec::new();
        for part in leaves(input, node, PHOTOS)? {
            let of_leaf = match known.entry(part.leaf) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(place) => place.insert(self.read_leaf(input, node, &part.leaf)?),
            };
            ids.extend(of_leaf.iter().cloned());
        }
        Ok(ids)
    }

    fn read_leaf(
        &mut self,
        input: &ReportInput<'_>,
        node: &NodeView,
        digest: &Digest,
    ) -> Result<Vec<String>, Missing> {
        let what = format!("A part of {PHOTOS} of {}", node.name);
        let bytes = (input.read)(digest).ok_or_else(|| Missing(not_stored(&what, digest)))?;
        let leaf = Leaf::decode(&bytes).map_err(|error| unreadable(node, PHOTOS, &error))?;
        let ids = leaf.rows.iter().map(|row| row.id.clone()).collect();
        for row in leaf.rows {
            self.entries.entry(row.id.clone()).or_insert_with(|| entry(&row));
        }
        Ok(ids)
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

/// Nodes whose photos no other node filters further.
pub(super) fn last_photo_nodes<'a>(input: &'a ReportInput<'_>) -> Vec<&'a NodeView> {
    let with_photos = || {
        input
            .nodes
            .iter()
            .filter(|node| node.outputs.contains_key(PHOTOS))
    };
    let consumed: BTreeSet<&str> = with_photos()
        .flat_map(|node| node.upstream.iter().map(|(_, upstream)| upstream.as_str()))
        .collect();
    with_photos()
        .filter(|node| !consumed.contains(node.name.as_str()))
        .collect()
}

/// Reads the verdicts of a node, sol by sol.
pub(super) fn verdicts(input: &ReportInput<'_>, node: &NodeView) -> Result<Vec<Verdict>, Missing> {
    let mut verdicts = Vec::new();
    for leaf in leaves(input, node, VERDICTS)? {
        let what = format!("A part of {VERDICTS} of {}", node.name);
        let bytes = (input.read)(&leaf.leaf).ok_or_else(|| Missing(not_stored(&what, &leaf.leaf)))?;
        verdicts.extend(sets::parse(&bytes).map_err(|error| unreadable(node, VERDICTS, &error))?);
    }
    Ok(verdicts)
}

/// Reads the leaves of an output that is a set.
fn leaves(input: &ReportInput<'_>, node: &NodeView, output: &str) -> Result<Vec<LeafRef>, Missing> {
    /// Why a set cannot be read.
    enum Fault {
        Lost(Digest),
        Malformed(ManifestError),
    }
    impl From<ManifestError> for Fault {
        fn from(error: ManifestError) -> Self {
            Self::Malformed(error)
        }
    }
    // The root itself has its own words where it is missing.
    read(input, node, output)?;
    let root = node
        .outputs
        .get(output)
        .copied()
        .unwrap_or_else(|| Digest::of(&[]));
    let get = |digest: &Digest| (input.read)(digest).ok_or(Fault::Lost(*digest));
    sets::leaves(&root, get).map_err(|fault| match fault {
        Fault::Lost(digest) => Missing(not_stored(
            &format!("A part of {output} of {}", node.name),
            &digest,
        )),
        Fault::Malformed(error) => unreadable(node, output, &error),
    })
}

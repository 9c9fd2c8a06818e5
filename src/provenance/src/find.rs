//! Finds a content in a store: its role, and the nodes and runs that have it.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{Digest, Record, Store, read_digest_list};
use marf_engine::{NodeRun, NodeState, OutputName, RunRecord};
use marf_model::{
    RunError,
    product::{SourcePart, origins, parts_of, products, set},
    unless_lost,
};
use marf_stage::{PHOTOS, VERDICTS};
use serde::Serialize;

/// Role of a content in a run.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Place {
    /// The root of the run.
    Root,
    /// A document of the run, by its name.
    Document(String),
    /// An output of a node.
    Output(OutputName),
    /// The action of a node: everything that its result depends on.
    Action(String),
    /// Part of a set of a node: what it says of one sol.
    Sol {
        /// The node.
        node: String,
        /// The output, a set of photos or of verdicts.
        output: String,
        /// The sol.
        sol: u32,
    },
    /// A blob of a product (`image`, `raw`, `label`, `thumbnail`) that a source read.
    Product {
        /// The source.
        node: String,
        /// The sol.
        sol: u32,
        /// The product.
        id: String,
        /// Role of the blob.
        role: String,
    },
    /// A file of an archive that no product was made of.
    File {
        /// The source.
        node: String,
        /// The sol.
        sol: u32,
        /// Name in the archive.
        file: String,
    },
    /// Something that a node stored in addition to its outputs.
    Stored(String),
}

/// A node, or a run as a whole, that has a content.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Maker {
    /// Role of the content.
    pub place: Place,
    /// Key of the node's result. `None` for a content of the run as a whole.
    pub key: Option<Digest>,
    /// Numbers of the runs that have it, oldest first.
    pub runs: Vec<u64>,
    /// Number of the run that made it. `None` if that run is gone, and the others reused the result.
    pub made_in: Option<u64>,
}

impl Place {
    /// Returns the node. `None` for a content of the run as a whole.
    pub fn node(&self) -> Option<&str> {
        match self {
            Self::Root | Self::Document(_) => None,
            Self::Output(OutputName { node, .. })
            | Self::Action(node)
            | Self::Sol { node, .. }
            | Self::Product { node, .. }
            | Self::File { node, .. }
            | Self::Stored(node) => Some(node),
        }
    }
}

/// Returns every maker of a content, those named in the run root first. `runs` are oldest first.
///
/// Contents that only objects of the store name (sols, photos, labels) are searched if no root names the
/// content.
///
/// # Errors
/// A store that cannot be read. What the store has lost is passed over.
pub fn find(store: &Store, runs: &[RunRecord], content: &Digest) -> Result<Vec<Maker>, RunError> {
    let mut makers = Makers::default();
    for run in runs {
        named_by(run, content, &mut makers);
    }
    if makers.0.is_empty() && store.contains(content) {
        let mut seen = Seen::default();
        for run in runs {
            for node in &run.nodes {
                for place in seen.places(store, node, content)? {
                    makers.add(place, run, Some(node));
                }
            }
        }
    }
    Ok(makers.0.into_values().collect())
}

#[derive(Default)]
struct Makers(BTreeMap<(Place, Option<Digest>), Maker>);

impl Makers {
    fn add(&mut self, place: Place, run: &RunRecord, node: Option<&NodeRun>) {
        let key = node.and_then(|node| node.key);
        let maker = self.0.entry((place.clone(), key)).or_insert_with(|| Maker {
            place,
            key,
            runs: Vec::new(),
            made_in: None,
        });
        if maker.runs.last() != Some(&run.number) {
            maker.runs.push(run.number);
        }
        let made = node.is_none_or(|node| node.state == NodeState::Finished);
        maker.made_in = maker.made_in.or(made.then_some(run.number));
    }
}

/// Adds what a run root itself names.
fn named_by(run: &RunRecord, content: &Digest, makers: &mut Makers) {
    if run.root == Some(*content) {
        makers.add(Place::Root, run, None);
    }
    for (name, document) in &run.documents {
        if document.digest == *content {
            makers.add(Place::Document(name.clone()), run, None);
        }
    }
    for node in &run.nodes {
        if node.key == Some(*content) {
            makers.add(Place::Action(node.name.clone()), run, Some(node));
        }
        for (output, found) in &node.outputs {
            if found.digest == *content {
                let place = Place::Output(OutputName {
                    node: node.name.clone(),
                    output: output.clone(),
                });
                makers.add(place, run, Some(node));
            }
        }
    }
}

/// Results searched already: most are in many runs.
#[derive(Default)]
struct Seen {
    /// Places of the content by the key of the node's result.
    nodes: BTreeMap<Digest, Vec<Place>>,
    parts: BTreeMap<Digest, bool>,
}

impl Seen {
    /// Returns where the content is in what objects of a node's result name.
    fn places(&mut self, store: &Store, node: &NodeRun, content: &Digest) -> Result<Vec<Place>, RunError> {
        let Some(key) = node.key else {
            return Ok(Vec::new());
        };
        if let Some(places) = self.nodes.get(&key) {
            return Ok(places.clone());
        }
        let mut places = Vec::new();
        if let Some(record) = store.record(&key)? {
            places = in_sets(store, node, content)?;
            if has_need(store, &record, content)? {
                places.push(Place::Stored(node.name.clone()));
            }
            for part in unless_lost(parts_of(store, &record))?.into_iter().flatten() {
                places.extend(self.in_part(store, node, &part, content)?);
            }
        }
        if places.len() > 1 {
            places.retain(|place| !matches!(place, Place::Stored(_)));
        }
        self.nodes.insert(key, places.clone());
        Ok(places)
    }

    /// Returns where the content is in one part of a node's result.
    fn in_part(
        &mut self,
        store: &Store,
        node: &NodeRun,
        part: &SourcePart,
        content: &Digest,
    ) -> Result<Vec<Place>, RunError> {
        if self.parts.get(&part.key) == Some(&false) {
            return Ok(Vec::new());
        }
        let places = match store.record(&part.key)? {
            Some(record) if has_need(store, &record, content)? => {
                in_record(store, node, part, &record, content)?
            }
            _ => Vec::new(),
        };
        self.parts.insert(part.key, !places.is_empty());
        Ok(places)
    }
}

/// Returns as what a part that stored the content has it: of a source a product or a file.
fn in_record(
    store: &Store,
    node: &NodeRun,
    part: &SourcePart,
    record: &Record,
    content: &Digest,
) -> Result<Vec<Place>, RunError> {
    let (name, sol) = (|| node.name.clone(), part.shard);
    let mut places = Vec::new();
    if record.origins.is_some() {
        for product in unless_lost(products(store, part))?.into_iter().flatten() {
            let roles = product.blobs.iter().filter(|(_, blob)| *blob == content);
            places.extend(roles.map(|(role, _)| Place::Product {
                node: name(),
                sol,
                id: product.id.clone(),
                role: role.clone(),
            }));
        }
    }
    if places.is_empty() {
        let files = unless_lost(origins(store, part))?.into_iter().flatten();
        let file = files.into_iter().find(|file| file.blake3 == *content);
        places.push(match file {
            Some(file) => Place::File {
                node: name(),
                sol,
                file: file.file,
            },
            None => Place::Stored(name()),
        });
    }
    Ok(places)
}

/// Returns the sols of the sets of a node whose leaf is the content.
fn in_sets(store: &Store, node: &NodeRun, content: &Digest) -> Result<Vec<Place>, RunError> {
    let mut places = Vec::new();
    for output in [PHOTOS, VERDICTS] {
        let Some(root) = node.outputs.get(output) else {
            continue;
        };
        let Some(set) = unless_lost(set(store, &root.digest))? else {
            continue;
        };
        let sols: BTreeSet<u32> = set
            .leaves
            .iter()
            .filter(|leaf| leaf.leaf == *content)
            .map(|leaf| leaf.shard)
            .collect();
        places.extend(sols.into_iter().map(|sol| Place::Sol {
            node: node.name.clone(),
            output: output.to_owned(),
            sol,
        }));
    }
    Ok(places)
}

/// Returns true if a record lists a blob among its needs.
fn has_need(store: &Store, record: &Record, content: &Digest) -> Result<bool, RunError> {
    let Some(list) = record.needs else {
        return Ok(false);
    };
    match store.get(&list) {
        Err(error) if error.lost().is_some() => Ok(false),
        bytes => Ok(read_digest_list(&bytes?).is_some_and(|needs| needs.binary_search(content).is_ok())),
    }
}

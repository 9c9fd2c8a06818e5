//! The lineage of a file.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::manifest::{Leaf, Root};
use marf_cache::{Digest, Store};
use marf_engine::{Build, OutputName};
use marf_model::{
    Run, RunError, RunNode,
    product::{Product, products, set},
    unless_lost,
};
use marf_provenance::find::Maker;
use marf_stage::PHOTOS;
use serde::Serialize;

/// Number of products listed by default.
const FIRST: usize = 3;

/// How much of a lineage is listed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// The first steps and products.
    Short,
    /// All of it.
    All,
}

/// Who made a file, with the lineage up to the products.
#[derive(Debug, Serialize)]
pub struct Origin {
    /// As what, and in which runs.
    pub maker: Maker,
    /// Number of the run described below: the one that made it, else the oldest that has it.
    pub run: u64,
    /// Digest of its root.
    pub root: Option<Digest>,
    /// The command as typed.
    pub command: String,
    /// The program with its version.
    pub program: String,
    /// The program to the byte, if the run knows it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub build: Option<Build>,
    /// Start, in seconds since 1970.
    pub started_unix_s: u64,
    /// The nodes that it was made by, in topological order. The last one that is not a child is the node itself.
    pub nodes: Vec<Step>,
    /// The products that the sources among them read.
    pub sources: Vec<Products>,
    /// The photos that it was made from. Absent if the store has lost a set of photos.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photos: Option<PhotoCount>,
}

/// How many photos went into something.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PhotoCount {
    /// Photos that went into it.
    pub used: u64,
    /// Photos that the archives gave.
    pub read: u64,
    /// Sols of the used photos. Empty if a photo has no known sol.
    pub sols: BTreeSet<u32>,
}

/// A node of a lineage.
#[derive(Debug, Serialize)]
pub struct Step {
    /// Its name.
    pub node: String,
    /// Its stage.
    pub stage: String,
    /// The node that it is a child of.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parent: Option<String>,
    /// Key of its result.
    pub key: Option<Digest>,
    /// Version of the stage. Absent if its action is lost.
    pub version: Option<u32>,
    /// Device that computed the result. Absent if its record is lost.
    pub device: Option<String>,
    /// Its parameters.
    pub params: serde_json::Value,
    /// Start, in seconds since 1970.
    pub started_unix_s: Option<u64>,
    /// Wall time, seconds.
    pub seconds: f64,
    /// Its inputs by name.
    pub inputs: BTreeMap<String, StepInput>,
    /// Its objects that are not in the store any more.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lost: Vec<String>,
}

/// An input of a node.
#[derive(Debug, Serialize)]
pub struct StepInput {
    /// Its digest.
    pub digest: Digest,
    /// The output that it is, if a node made it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub made_by: Option<OutputName>,
    /// Photos in the set, where it is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photos: Option<u64>,
}

/// The products that a source read.
#[derive(Debug, Default, Serialize)]
pub struct Products {
    /// The source.
    pub node: String,
    /// How many photos it gave.
    pub photos: u64,
    /// How many sols they are of.
    pub sols: usize,
    /// The first ones, or all.
    pub listed: Vec<Product>,
    /// Sols whose products are lost.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lost_sols: Vec<u32>,
}

impl Origin {
    /// Returns whether something of the lineage is known to be gone.
    pub fn is_incomplete(&self) -> bool {
        let of_source = |source: &Products| !source.lost_sols.is_empty();
        self.nodes.iter().any(|node| !node.lost.is_empty()) || self.sources.iter().any(of_source)
    }
}

/// Returns the origin of a content. `nodes` are the nodes that it was made by.
///
/// # Errors
/// A store that cannot be read.
pub fn origin_of(
    lineage: &Run<'_>,
    maker: &Maker,
    nodes: &[&RunNode],
    detail: Detail,
) -> Result<Origin, RunError> {
    let run = &lineage.record;
    let most = match detail {
        Detail::All => usize::MAX,
        Detail::Short => FIRST,
    };
    let sources = nodes.iter().filter(|node| node.is_source());
    let sources = sources.map(|node| read_by(lineage.store(), node, most));
    let sources: Vec<Products> = sources.collect::<Result<_, _>>()?;
    let read = sources.iter().map(|source| source.photos).sum();
    Ok(Origin {
        photos: unless_lost(photos_of(lineage.store(), nodes, read))?,
        maker: maker.clone(),
        run: run.number,
        root: run.root,
        command: run.command.clone(),
        program: run.program.clone(),
        build: run.build.clone(),
        started_unix_s: run.started_unix_s,
        nodes: nodes.iter().map(|node| step(lineage.store(), node)).collect(),
        sources,
    })
}

/// Counts the photos that nodes read and did not pass on to others. Where all pass them on, counts those that the last one read or gave.
fn photos_of(store: &Store, nodes: &[&RunNode], read: u64) -> Result<PhotoCount, RunError> {
    let set_of = |node: &RunNode| {
        let input = node.run.inputs.get(PHOTOS).map(|input| input.digest);
        input.or_else(|| node.run.outputs.get(PHOTOS).map(|output| output.digest))
    };
    let whole = || nodes.iter().filter(|node| !node.is_child());
    let ends = whole().filter(|node| !node.run.outputs.contains_key(PHOTOS));
    let mut sets: BTreeSet<Digest> = ends.filter_map(|node| set_of(node)).collect();
    if sets.is_empty() {
        sets.extend(whole().rev().find_map(|node| set_of(node)));
    }
    let mut photos = BTreeSet::new();
    for root in &sets {
        for leaf in set(store, root)?.leaves {
            let rows = Leaf::decode(&store.get(&leaf.leaf)?)?.rows;
            photos.extend(rows.into_iter().map(|row| (leaf.shard, row.id)));
        }
    }
    let sols: BTreeSet<u32> = photos.iter().map(|(sol, _)| *sol).collect();
    Ok(PhotoCount {
        used: photos.len() as u64,
        read,
        sols: if sols.contains(&0) { BTreeSet::new() } else { sols },
    })
}

fn step(store: &Store, node: &RunNode) -> Step {
    let run = &node.run;
    let mut lost = Vec::new();
    if run.state.is_good() {
        lost.extend(node.action.is_none().then(|| "its action".to_owned()));
        lost.extend(node.record.is_none().then(|| "its record".to_owned()));
        let outputs = run
            .outputs
            .iter()
            .filter(|(_, output)| !store.contains(&output.digest));
        lost.extend(outputs.map(|(name, _)| format!("its output `{name}`")));
    }
    let input = |(name, input): (&String, &marf_engine::NodeInput)| {
        let bytes = (name == PHOTOS).then(|| store.get(&input.digest).ok()).flatten();
        let input = StepInput {
            digest: input.digest,
            made_by: input.made_by.clone(),
            photos: bytes.and_then(|bytes| Root::count(&bytes).ok()),
        };
        (name.clone(), input)
    };
    Step {
        node: run.name.clone(),
        stage: run.stage.clone(),
        parent: run.parent.clone(),
        key: run.key,
        version: node.action.as_ref().map(|action| action.version),
        device: node.record.as_ref().map(|record| record.metadata.device.clone()),
        params: node
            .action
            .as_ref()
            .map(|action| action.params.clone())
            .unwrap_or_default(),
        started_unix_s: run.started_unix_s,
        seconds: run.seconds,
        inputs: run.inputs.iter().map(input).collect(),
        lost,
    }
}

/// Returns the products that a source read: the number of all sols, and the first products.
fn read_by(store: &Store, source: &RunNode, most: usize) -> Result<Products, RunError> {
    let mut read = Products {
        node: source.run.name.clone(),
        photos: source.run.counts.get("photos").copied().unwrap_or(0),
        ..Products::default()
    };
    let parts = unless_lost(source.parts(store))?.unwrap_or_default();
    read.sols = parts.len();
    for part in &parts {
        if read.listed.len() >= most {
            break;
        }
        match unless_lost(products(store, part))? {
            None => read.lost_sols.push(part.shard),
            Some(products) => {
                let room = most - read.listed.len();
                read.listed.extend(products.into_iter().take(room));
            }
        }
    }
    Ok(read)
}

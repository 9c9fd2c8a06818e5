//! Everything derived from a product: the nodes of each run that read it, or read a result made from it.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{Digest, Store, manifest::Leaf};
use marf_engine::OutputName;
use marf_model::{
    Run, RunError,
    product::{Product, products, set},
};
use marf_stage::PHOTOS;
use serde::Serialize;

/// A run that a product went into.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Tainted {
    /// Number of the run.
    pub run: u64,
    /// The command as typed.
    pub command: String,
    /// Its nodes that read the product, or something made from it, in topological order.
    pub nodes: Vec<TaintedNode>,
    /// The nodes that read sets of photos and give sets without it: who rejected it.
    pub rejected_by: Vec<String>,
}

/// A node that a product went into.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TaintedNode {
    /// Its name.
    pub node: String,
    /// Its stage.
    pub stage: String,
    /// Inputs that hold the product or were made from it.
    pub through: Vec<String>,
    /// Outputs that hold it or were made from it.
    pub outputs: BTreeMap<String, Digest>,
}

/// Returns a product of a run by its id, the name of a file of it, or the digest of one of its blobs.
///
/// # Errors
/// A store that cannot be read, or has lost the list of products.
pub fn product_of(run: &Run<'_>, wanted: &str) -> Result<Option<Product>, RunError> {
    let store = run.store();
    let digest: Option<Digest> = wanted.parse().ok();
    let is_wanted = |product: &Product| {
        let of_file = product.origins.values().any(|origin| origin.file == wanted);
        let of_blob = digest.is_some_and(|digest| product.blobs.values().any(|blob| *blob == digest));
        product.id == wanted || of_file || of_blob
    };
    for source in run.sources() {
        for part in source.parts(store)? {
            if let Some(product) = products(store, &part)?.into_iter().find(is_wanted) {
                return Ok(Some(product));
            }
        }
    }
    Ok(None)
}

/// Returns everything derived from a product in one run. `None` if no source of the run read it.
///
/// A set of photos is tainted if it holds the product, any other output if one of the inputs of its maker is.
/// A filter that rejects a product has looked at it, and its verdicts on others may depend on it. Such a
/// filter is among the nodes, but results from its photos are not.
///
/// # Errors
/// A store that cannot be read, or has lost a set.
pub fn tainted(run: &Run<'_>, product: &Product) -> Result<Option<Tainted>, RunError> {
    let store = run.store();
    let mut tainted: BTreeSet<OutputName> = BTreeSet::new();
    let mut answer = Tainted {
        run: run.record.number,
        command: run.record.command.clone(),
        nodes: Vec::new(),
        rejected_by: Vec::new(),
    };
    for node in run.nodes.iter().filter(|node| node.run.state.is_good()) {
        let of_tainted = node.run.inputs.iter().filter(|(_, input)| {
            input
                .made_by
                .as_ref()
                .is_some_and(|made_by| tainted.contains(made_by))
        });
        let mut through: Vec<String> = of_tainted.map(|(name, _)| name.clone()).collect();
        let photos = node.run.outputs.get(PHOTOS).map(|output| output.digest);
        let holds = photos.map(|photos| holds(store, &photos, product)).transpose()?;
        if node.is_source() && holds == Some(true) {
            through.push("archive".to_owned());
        }
        if through.is_empty() {
            continue;
        }
        if holds == Some(false) {
            answer.rejected_by.push(node.run.name.clone());
        }
        let outputs = node
            .run
            .outputs
            .iter()
            .filter(|(name, _)| *name != PHOTOS || holds == Some(true));
        let outputs: BTreeMap<String, Digest> = outputs
            .map(|(name, output)| (name.clone(), output.digest))
            .collect();
        tainted.extend(outputs.keys().map(|output| OutputName {
            node: node.run.name.clone(),
            output: output.clone(),
        }));
        answer.nodes.push(TaintedNode {
            node: node.run.name.clone(),
            stage: node.run.stage.clone(),
            through,
            outputs,
        });
    }
    Ok((!answer.nodes.is_empty()).then_some(answer))
}

/// Returns true if a set holds a product. Only the leaves of its sol are read.
fn holds(store: &Store, root: &Digest, product: &Product) -> Result<bool, RunError> {
    for leaf in set(store, root)?
        .leaves
        .into_iter()
        .filter(|leaf| leaf.shard == product.shard)
    {
        let rows = Leaf::decode(&store.get(&leaf.leaf)?)?.rows;
        let same = |row: &marf_cache::manifest::Row| row.id == product.id && row.blobs == product.blobs;
        if rows.iter().any(same) {
            return Ok(true);
        }
    }
    Ok(false)
}

//! Changes between two runs, node by node.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{
    Digest, Store,
    manifest::{Leaf, LeafRef},
};
use marf_engine::{Change, differences};
use marf_model::{Run, RunError, RunNode, product::set, unless_lost};
use marf_stage::{PHOTOS, VERDICTS};
use serde::Serialize;

use crate::difference::values;

/// Changes of a node.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NodeDiff {
    /// Its name.
    pub node: String,
    /// Whether both runs have it.
    pub presence: Presence,
    /// Differences of its action: parameters, versions, inputs, backend.
    pub changes: Vec<Change>,
    /// Products that its set of photos has and had not, had and has not, and has with other bytes or facts.
    pub products: ProductsDiff,
    /// Outputs whose bytes differ, with the old and the new digest.
    pub outputs: BTreeMap<String, (Option<Digest>, Option<Digest>)>,
    /// Values that differ in outputs that are JSON documents, by output.
    pub values: BTreeMap<String, Vec<Change>>,
}

/// In which of two runs a node has a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Presence {
    /// In both.
    Both,
    /// In the first alone.
    First,
    /// In the second alone.
    Second,
}

/// Difference of two sets of photos, as sorted ids.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct ProductsDiff {
    /// In the second set alone.
    pub added: Vec<String>,
    /// In the first set alone.
    pub removed: Vec<String>,
    /// In both, with other bytes or facts.
    pub edited: Vec<String>,
}

/// Returns the nodes that differ between two runs of a store, in the order of the second run. Nodes of the
/// first run alone come last.
///
/// # Errors
/// A store that cannot be read. What the store has lost of a set or a document is not compared.
pub fn diff(first: &Run<'_>, second: &Run<'_>) -> Result<Vec<NodeDiff>, RunError> {
    let mut found = Vec::new();
    for node in good(second) {
        let before = good(first).find(|before| before.run.name == node.run.name);
        found.push(of_node(second.store(), before, Some(node))?);
    }
    for node in good(first) {
        if good(second).all(|after| after.run.name != node.run.name) {
            found.push(of_node(second.store(), Some(node), None)?);
        }
    }
    found.retain(|node| {
        node.presence != Presence::Both || !node.changes.is_empty() || !node.outputs.is_empty()
    });
    Ok(found)
}

/// Returns the nodes of a run that have a result.
fn good<'r>(run: &'r Run<'_>) -> impl Iterator<Item = &'r RunNode> {
    run.nodes.iter().filter(|node| node.run.state.is_good())
}

fn of_node(store: &Store, before: Option<&RunNode>, after: Option<&RunNode>) -> Result<NodeDiff, RunError> {
    let name = after
        .or(before)
        .map(|node| node.run.name.clone())
        .unwrap_or_default();
    let outputs = |node: Option<&RunNode>| -> BTreeMap<String, Digest> {
        let outputs = node.into_iter().flat_map(|node| &node.run.outputs);
        outputs
            .map(|(name, output)| (name.clone(), output.digest))
            .collect()
    };
    let (was, is) = (outputs(before), outputs(after));
    let mut diff = NodeDiff {
        node: name,
        presence: match (before, after) {
            (Some(_), None) => Presence::First,
            (None, Some(_)) => Presence::Second,
            _ => Presence::Both,
        },
        changes: Vec::new(),
        products: ProductsDiff::default(),
        outputs: BTreeMap::new(),
        values: BTreeMap::new(),
    };
    let actions = |node: Option<&RunNode>| node.and_then(|node| node.action.clone());
    if let (Some(old), Some(new)) = (actions(before), actions(after)) {
        diff.changes = differences(&old, &new);
    }
    let names: BTreeSet<&String> = was.keys().chain(is.keys()).collect();
    for name in names {
        let (was, is) = (was.get(name).copied(), is.get(name).copied());
        if was == is {
            continue;
        }
        diff.outputs.insert(name.clone(), (was, is));
        let Some((was, is)) = was.zip(is) else { continue };
        if name == PHOTOS {
            diff.products = unless_lost(of_sets(store, &was, &is))?.unwrap_or_default();
        }
        // A root of a set of few sols is one line of JSON, and no document.
        if name == PHOTOS || name == VERDICTS {
            continue;
        }
        let both = || Ok(values(&store.get(&was)?, &store.get(&is)?));
        if let Some(values) = unless_lost(both())?.filter(|values| !values.is_empty()) {
            diff.values.insert(name.clone(), values);
        }
    }
    Ok(diff)
}

/// Compares two sets of photos. Leaves that both have are not read.
fn of_sets(store: &Store, was: &Digest, is: &Digest) -> Result<ProductsDiff, RunError> {
    let (was, is) = (set(store, was)?.leaves, set(store, is)?.leaves);
    let shared: BTreeSet<Digest> = was.iter().map(|leaf| leaf.leaf).collect();
    let shared: BTreeSet<Digest> = is
        .iter()
        .map(|leaf| leaf.leaf)
        .filter(|leaf| shared.contains(leaf))
        .collect();
    let (was, is) = (rows(store, &was, &shared)?, rows(store, &is, &shared)?);
    let only = |of: &BTreeMap<String, Digest>, other: &BTreeMap<String, Digest>| -> Vec<String> {
        of.keys().filter(|id| !other.contains_key(*id)).cloned().collect()
    };
    let edited = is
        .iter()
        .filter(|(id, row)| was.get(*id).is_some_and(|old| old != *row));
    Ok(ProductsDiff {
        added: only(&is, &was),
        removed: only(&was, &is),
        edited: edited.map(|(id, _)| id.clone()).collect(),
    })
}

/// Returns the rows of leaves by id, each as the digest of its bytes.
fn rows(
    store: &Store,
    leaves: &[LeafRef],
    without: &BTreeSet<Digest>,
) -> Result<BTreeMap<String, Digest>, RunError> {
    let mut rows = BTreeMap::new();
    for leaf in leaves.iter().filter(|leaf| !without.contains(&leaf.leaf)) {
        for row in Leaf::decode(&store.get(&leaf.leaf)?)?.rows {
            let id = row.id.clone();
            rows.insert(id, Digest::from_content(&Leaf { rows: vec![row] }.encode()));
        }
    }
    Ok(rows)
}

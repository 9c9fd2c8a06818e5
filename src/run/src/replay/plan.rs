//! The graph of a replay, and what its store must have before it runs.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use marf_cache::{Digest, Store};
use marf_engine::{Graph, RunRecord, RunSource};
use marf_field::Device;
use marf_model::{Run, RunNode};
use marf_provenance::replay::{copy_archive, copy_record, recorded};
use marf_schema::train::{Metrics, Setup, TrainParams};
use marf_stage::{Document, EARLIER, Params};
use serde_json::Value;

use crate::documents::{put_on_cpu, resolved};
use crate::error::Error;
use crate::session::graph_of;
use marf_config::{GlobalOptions, check_tree};

/// How a run is made again.
pub struct Plan {
    /// The pipeline as it ran, reading what was recorded of archives.
    pub graph: Graph,
    /// The nodes to run, with all that they need.
    pub to: Vec<String>,
    /// Nodes that are not made again, with the reason.
    pub not_made: BTreeMap<String, String>,
}

/// Prepares a replay of some nodes of a run in an empty store.
///
/// # Errors
/// An object that is needed and not in the store any more, or a pipeline that this program does not read.
pub fn plan(lineage: &Run<'_>, nodes: &[&RunNode], scratch: &Store) -> Result<Plan, Error> {
    let mut tree = resolved(lineage.store(), &lineage.record)?;
    let mut options = GlobalOptions::default();
    for source in nodes
        .iter()
        .filter(|node| node.is_source() && node.run.state.is_good())
    {
        let archive = recorded(lineage.store(), source)?;
        copy_archive(&archive, lineage.store(), scratch)?;
        options.recorded.insert(source.run.name.clone(), archive);
    }
    let not_made = on_other_devices(nodes);
    // What is not made looks for no GPU.
    let wanted: BTreeSet<&str> = nodes.iter().map(|node| node.run.name.as_str()).collect();
    for node in &lineage.nodes {
        let name = node.run.name.as_str();
        if !wanted.contains(name) || not_made.contains_key(name) {
            put_on_cpu(&mut tree, &node.run);
        }
    }
    let mut repeated = BTreeSet::new();
    for node in nodes {
        if repeat(&mut tree, lineage.store(), node)? {
            repeated.insert(node.run.name.as_str());
        }
    }
    continue_from(lineage, nodes, &repeated, scratch)?;
    let pipeline = check_tree(&tree, &options, Path::new("")).map_err(|error| {
        Error::failed(format!(
            "the pipeline of run {}: {}",
            lineage.record.number, error.message
        ))
    })?;
    let is_made = |node: &&&RunNode| {
        !node.is_child() && node.run.state.is_good() && !not_made.contains_key(&node.run.name)
    };
    Ok(Plan {
        graph: graph_of(pipeline.nodes)?,
        to: nodes
            .iter()
            .filter(is_made)
            .map(|node| node.run.name.clone())
            .collect(),
        not_made,
    })
}

/// Returns the nodes that ran on a GPU that is not here, and those that need them, with the reason.
fn on_other_devices(nodes: &[&RunNode]) -> BTreeMap<String, String> {
    let mut not_made = BTreeMap::new();
    let mut here: Option<Option<String>> = None;
    for node in nodes {
        let action = node.action.iter();
        let backends = action.flat_map(|action| {
            let children = action
                .children
                .values()
                .filter_map(|child| child.backend.as_ref());
            action.backend.iter().chain(children)
        });
        let foreign = backends.into_iter().find(|backend| {
            let here = here.get_or_insert_with(|| marf_field_gpu::backend_id(&Device::default()));
            here.as_ref() != Some(backend)
        });
        let needed = node
            .run
            .inputs
            .values()
            .filter_map(|input| input.made_by.as_ref());
        let needed = needed.map(|made_by| &made_by.node).chain(&node.run.parent);
        let needs = needed
            .into_iter()
            .find(|name| not_made.contains_key(*name))
            .cloned();
        let reason = match (foreign, needs) {
            (Some(backend), _) => format!("it ran on {backend}, which is not here"),
            (None, Some(needs)) => format!("it needs `{needs}`, which is not made here"),
            (None, None) => continue,
        };
        not_made.insert(node.run.name.clone(), reason);
    }
    not_made
}

/// Replaces the parameters of a training by the clock with those of the schedule that it ran, which repeat it. Returns whether `node` was
/// such a training.
fn repeat(tree: &mut Value, store: &Store, node: &RunNode) -> Result<bool, Error> {
    let Some(repeating) = repeating(store, node)? else {
        return Ok(false);
    };
    let table = tree["node"]
        .get_mut(&node.run.name)
        .and_then(Value::as_object_mut);
    if let (Some(table), Value::Object(repeating)) = (table, repeating) {
        table.retain(|key, _| !matches!(key.as_str(), "budget" | "within"));
        table.extend(repeating);
    }
    Ok(true)
}

/// Returns the keys that repeat a training by the clock. None for all other nodes.
fn repeating(store: &Store, node: &RunNode) -> Result<Option<Value>, Error> {
    let Some(setup) = node.run.outputs.get(Setup::OUTPUT) else {
        return Ok(None);
    };
    let action = node
        .action
        .as_ref()
        .filter(|_| node.run.stage == TrainParams::STAGE);
    let params = action.map(|action| serde_json::from_value::<TrainParams>(action.params.clone()));
    let Some(Ok(params)) = params else {
        return Ok(None);
    };
    let unreadable = |error: serde_json::Error| Error::failed(format!("`{}`: {error}", node.run.name));
    let metrics = node.run.outputs.get(Metrics::OUTPUT).unwrap_or(setup);
    let setup = Setup::decode(&store.get(&setup.digest)?).map_err(unreadable)?;
    let metrics = Metrics::decode(&store.get(&metrics.digest)?).map_err(unreadable)?;
    let Some(repeating) = params.repeating(&setup, &metrics) else {
        return Ok(None);
    };
    let mut keys = serde_json::to_value(repeating).map_err(unreadable)?;
    let before = serde_json::to_value(params).map_err(unreadable)?;
    if let Some(keys) = keys.as_object_mut() {
        keys.retain(|key, value| before.get(key) != Some(value));
    }
    Ok(Some(keys))
}

/// Lets nodes that continued from their own earlier output continue from it again. The store gets records of their earlier results, with
/// only that output.
///
/// A `repeated` node has other parameters now, so it continues from the result of the previous run, as any node with changed parameters
/// does.
fn continue_from(
    lineage: &Run<'_>,
    nodes: &[&RunNode],
    repeated: &BTreeSet<&str>,
    scratch: &Store,
) -> Result<(), Error> {
    let store = lineage.store();
    let continued = nodes.iter().filter_map(|node| {
        let earlier = node.run.inputs.get(EARLIER)?.digest;
        Some((&node.run, earlier, node.run.key?))
    });
    let continued: Vec<_> = continued.collect();
    if continued.is_empty() {
        return Ok(());
    }
    let all: Vec<_> = marf_engine::runs(store, |_| {})?
        .into_iter()
        .flat_map(|run| run.nodes)
        .collect();
    let (mut latest, mut before) = (BTreeMap::new(), Vec::new());
    for (run, earlier, key) in continued {
        let gave = all.iter().filter(|node| {
            let mut outputs = node.outputs.values();
            node.stage == run.stage && outputs.any(|output| output.digest == earlier)
        });
        let gave: Vec<Digest> = gave.filter_map(|node| node.key).collect();
        let known = if repeated.contains(run.name.as_str()) {
            gave.first().copied()
        } else {
            Some(key)
        };
        if let Some(known) = known {
            copy_record(&known, store, scratch)?;
            latest.insert(run.name.clone(), known);
        }
        before.extend(gave);
    }
    for blob in store.closure(&before, &[])?.blobs {
        scratch.put(&store.get(&blob)?)?;
    }
    let known = RunRecord {
        nodes: Vec::new(),
        documents: BTreeMap::new(),
        latest,
        source: RunSource::default(),
        ..lineage.record.clone()
    };
    known.store(scratch, |_| {})?;
    Ok(())
}

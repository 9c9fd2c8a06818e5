//! The plan: what a run would do with each node, and why. It lists sources and stores nothing.

use marf_cache::{Digest, Store};
use marf_stage::{Cancel, Inputs, Outputs};
use serde::Serialize;

use crate::{
    earlier::{KeyRequest, key_of},
    graph::{Graph, Node},
    key::{Change, Key},
    listing::{NoProgress, list},
    lookup::{Lookup, RunReason, because, look_up, outputs_of, why_missed},
    record::{EngineError, RunRecord},
};

/// What a run would do with a node.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlannedNode {
    /// Name of the node.
    pub node: String,
    /// Name of its stage.
    pub stage: String,
    /// Whether it would run.
    pub state: PlanState,
    /// Why: the first difference from its last key.
    pub reason: String,
    /// Its key, as far as its inputs are known.
    pub key: Option<Digest>,
    /// All differences from its last key.
    pub changes: Vec<Change>,
}

/// Whether a node would run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PlanState {
    /// The last run has its result.
    Fresh,
    /// An earlier run has its result.
    Cached,
    /// It would run.
    WillRun,
}

/// Returns what a run would do, in topological order. `last` is the last run of this pipeline.
///
/// # Errors
/// A store that cannot be read.
pub fn plan(graph: &Graph, store: &Store, last: Option<&RunRecord>) -> Result<Vec<PlannedNode>, EngineError> {
    let mut known: Vec<Option<Outputs>> = Vec::new();
    let mut planned = Vec::new();
    for index in 0..graph.nodes.len() {
        let (node, outputs) = plan_node(graph, store, last, index, &known)?;
        known.push(outputs);
        planned.push(node);
    }
    Ok(planned)
}

/// Returns what a run would do with one node.
///
/// # Errors
/// A store that cannot be read, a name that is not in the graph.
pub fn why(
    graph: &Graph,
    store: &Store,
    last: Option<&RunRecord>,
    node: &str,
) -> Result<PlannedNode, EngineError> {
    let planned = plan(graph, store, last)?.into_iter();
    let mut found = planned.filter(|planned| planned.node == node);
    found.next().ok_or_else(|| EngineError::UnknownNode {
        node: node.to_owned(),
        known: graph.names().into_iter().map(str::to_owned).collect(),
    })
}

/// Plans one node; returns its outputs too if they are in the store.
fn plan_node(
    graph: &Graph,
    store: &Store,
    last: Option<&RunRecord>,
    index: usize,
    known: &[Option<Outputs>],
) -> Result<(PlannedNode, Option<Outputs>), EngineError> {
    let node = &graph.nodes[index];
    let planned = |state, why: RunReason, key: Option<&Key>| PlannedNode {
        node: node.name.clone(),
        stage: node.def.name.to_owned(),
        state,
        reason: why.reason,
        key: key.map(|key| key.digest),
        changes: why.changes,
    };
    let inputs = match inputs_of(node, known) {
        Ok(inputs) => inputs,
        Err(upstream) => {
            let reason = format!("upstream {} will run", graph.nodes[upstream].name);
            return Ok((planned(PlanState::WillRun, because(reason), None), None));
        }
    };
    let listing = match list(node.bound.as_ref(), store, &Cancel::default(), &NoProgress) {
        Ok(listing) => listing,
        Err(error) => {
            let reason = format!("it cannot list what is there: {error}");
            return Ok((planned(PlanState::WillRun, because(reason), None), None));
        }
    };
    let request = KeyRequest {
        name: &node.name,
        def: &node.def,
        stage: node.bound.as_ref(),
        listing: listing.as_ref(),
    };
    let (key, _) = key_of(store, last, &request, inputs)?;
    let lookup = look_up(store, &key.digest)?;
    let Lookup::Hit(record) = lookup else {
        let mut why = why_missed(store, last, &node.name, &key, &lookup)?;
        why.reason = listing.map_or(why.reason.clone(), |listing| listing.noted(&why.reason));
        return Ok((planned(PlanState::WillRun, why, Some(&key)), None));
    };
    let is_last = last.is_some_and(|run| run.latest.get(&node.name) == Some(&key.digest));
    let (state, reason) = match is_last {
        true => (PlanState::Fresh, "nothing changed"),
        false => (PlanState::Cached, "its result is in the store"),
    };
    let planned = planned(state, because(reason.to_owned()), Some(&key));
    Ok((planned, Some(outputs_of(&record))))
}

/// Returns the inputs of a node, or an upstream node whose outputs are not known.
fn inputs_of(node: &Node, known: &[Option<Outputs>]) -> Result<Inputs, usize> {
    let mut inputs = Inputs::default();
    for connection in &node.connections {
        let outputs = known[connection.upstream].as_ref().ok_or(connection.upstream)?;
        let output = outputs.get(connection.output);
        inputs
            .0
            .extend(output.map(|digest| (connection.output.to_owned(), *digest)));
    }
    Ok(inputs)
}

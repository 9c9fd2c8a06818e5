//! The plan: the state of each node in a run, and why. It lists sources and stores nothing.

use std::num::NonZero;

use marf_cache::{Digest, RunMetadata, Store};
use marf_stage::{Cancel, Inputs, Outputs};
use serde::Serialize;

use crate::{
    earlier::KeyRequest,
    graph::{Graph, Node},
    key::{Change, Key, action_at, node_key},
    listing::{Inquiry, NoProgress, SourceListing},
    lookup::{Lookup, RunReason, because, look_up, lost_output, outputs_of, why_missed},
    needs::Needs,
    record::{EngineError, RunRecord},
    run,
    shared::SharedResults,
    work::{Extent, extent},
};

/// The planned state of a node.
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
    /// Its key, if its inputs are known.
    pub key: Option<Digest>,
    /// All differences from its last key.
    pub changes: Vec<Change>,
    /// The photos that it would look at, if they are known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extent: Option<Extent>,
    /// Its needs: cores, GPU, memory, time.
    pub needs: Needs,
}

/// Whether a node would run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PlanState {
    /// The last run has its result.
    Fresh,
    /// An earlier run, or the shared store, has its result.
    Cached,
    /// It would run.
    WillRun,
    /// What is upstream of it would run, and nothing else changed since it last ran: it runs unless that comes out as it was.
    MayRun,
}

impl PlanState {
    /// Returns the state in the words of a plan.
    pub fn word(self) -> &'static str {
        match self {
            Self::Fresh => "fresh",
            Self::Cached => "cached",
            Self::WillRun => "will run",
            Self::MayRun => "may run",
        }
    }

    /// Returns whether the node may run.
    pub fn is_open(self) -> bool {
        matches!(self, Self::WillRun | Self::MayRun)
    }
}

/// How a run is planned.
#[derive(Debug, Clone, Default)]
pub struct PlanOptions<'a> {
    /// Threads for listings, by default all cores.
    pub threads: Option<NonZero<usize>>,
    /// Set when the user wants to stop.
    pub cancel: Cancel,
    /// From where the run fetches results that its store lacks.
    pub shared: Option<&'a dyn SharedResults>,
}

/// Returns the plan of a run, in topological order. `last` is the last run of this pipeline.
///
/// # Errors
/// A store that cannot be read, the wish to stop.
pub fn plan(
    graph: &Graph,
    store: &Store,
    last: Option<&RunRecord>,
    options: &PlanOptions<'_>,
) -> Result<Vec<PlannedNode>, EngineError> {
    let known = plan_all(graph, store, last, options)?.into_iter();
    Ok(known.map(|known| known.node).collect())
}

/// As [`plan`], with the inputs and outputs of each node where they are known.
pub(crate) fn plan_all(
    graph: &Graph,
    store: &Store,
    last: Option<&RunRecord>,
    options: &PlanOptions<'_>,
) -> Result<Vec<NodePreview>, EngineError> {
    let planner = Planner {
        shared: options.shared,
        graph,
        store,
        last,
        cancel: &options.cancel,
        pool: run::pool(run::threads(options.threads))?,
    };
    let mut known: Vec<NodePreview> = Vec::new();
    for index in 0..graph.nodes.len() {
        let node = planner.node(index, &known)?;
        known.push(node);
    }
    Ok(known)
}

/// A planned node, its inputs if they are known, the listing of a source, and its outputs if they are in the store.
pub(crate) struct NodePreview {
    pub(crate) node: PlannedNode,
    pub(crate) inputs: Option<Inputs>,
    pub(crate) listed: Option<SourceListing>,
    pub(crate) outputs: Option<Outputs>,
}

/// What planning needs.
struct Planner<'a> {
    graph: &'a Graph,
    store: &'a Store,
    last: Option<&'a RunRecord>,
    cancel: &'a Cancel,
    pool: rayon::ThreadPool,
    shared: Option<&'a dyn SharedResults>,
}

impl Planner<'_> {
    fn node(&self, index: usize, known: &[NodePreview]) -> Result<NodePreview, EngineError> {
        let node = &self.graph.nodes[index];
        let mut inputs = match inputs_of(node, known) {
            Ok(inputs) => inputs,
            Err(upstream) => return Ok(self.behind(node, &known[upstream].node)),
        };
        let inquiry = Inquiry {
            store: self.store,
            cancel: self.cancel,
            progress: &NoProgress,
            pool: &self.pool,
        };
        let ask = || inquiry.list(node.bound.as_ref());
        let listed = match self.graph.listed(&node.name, ask) {
            Ok(listed) => listed,
            Err(_) if self.cancel.is_set() => return Err(EngineError::Stopped),
            Err(error) => {
                let why = because(format!("it cannot list what is there: {error}"));
                return Ok(self.will_run(node, why, None, None));
            }
        };
        inputs
            .0
            .extend(listed.iter().flat_map(|listed| listed.inputs.0.clone()));
        let request = KeyRequest {
            table: &self.graph.table,
            executor: None,
            name: &node.name,
            def: &node.def,
            stage: node.bound.as_ref(),
        };
        let (key, inputs) = match request.key(self.store, self.last, inputs) {
            Ok(keyed) => keyed,
            Err(error) => return Ok(self.will_run(node, because(error.to_string()), None, None)),
        };
        let lookup = look_up(self.store, &key.digest)?;
        let is_here = matches!(lookup, Lookup::Hit(_));
        let lookup = match lookup {
            Lookup::Hit(_) => lookup,
            lacking => self
                .shared
                .and_then(|shared| shared.record(&key.digest))
                .map_or(lacking, |record| Lookup::Hit(Box::new(record))),
        };
        let Lookup::Hit(record) = lookup else {
            let mut why = match lookup {
                Lookup::MissingOutput(output) => lost_output(&output),
                _ => why_missed(self.store, self.last, &node.name, &key, listed.as_ref())?,
            };
            if let Some(listed) = &listed {
                why.reason = listed.listing.noted(&why.reason);
            }
            let extent = extent(self.store, node.bound.as_ref(), &key, &inputs, listed.as_ref())?;
            return Ok(NodePreview {
                inputs: Some(inputs),
                listed,
                ..self.will_run(node, why, Some(&key), extent)
            });
        };
        let is_last = self
            .last
            .is_some_and(|run| run.latest.get(&node.name) == Some(&key.digest));
        let (state, reason) = match (is_here, is_last) {
            (false, _) => (PlanState::Cached, "its result is in the shared store"),
            (true, true) => (PlanState::Fresh, "nothing changed"),
            (true, false) => (PlanState::Cached, "its result is in the store"),
        };
        Ok(NodePreview {
            node: PlannedNode {
                state,
                ..self
                    .will_run(node, because(reason.to_owned()), Some(&key), None)
                    .node
            },
            inputs: Some(inputs),
            listed,
            outputs: Some(outputs_of(&record)),
        })
    }

    /// Returns the plan of a node downstream of one that will or may run. It looks at the same photos, or at fewer.
    fn behind(&self, node: &Node, upstream: &PlannedNode) -> NodePreview {
        let why = because(format!("upstream {} {}", upstream.node, upstream.state.word()));
        let mut known = self.will_run(node, why, None, upstream.extent);
        if self.is_itself(node) {
            known.node.state = PlanState::MayRun;
        }
        known
    }

    /// Returns whether the node itself is unchanged: with the inputs of its last result, it has the same key.
    fn is_itself(&self, node: &Node) -> bool {
        let key = self.last.and_then(|run| run.latest.get(&node.name));
        let action = key.and_then(|key| action_at(self.store, key).ok().flatten());
        action.is_some_and(|action| {
            let inputs = Inputs(action.inputs.clone());
            let now = node_key(&self.graph.table, None, &node.def, node.bound.as_ref(), &inputs);
            now.is_ok_and(|now| Some(&now.digest) == key)
        })
    }

    fn will_run(
        &self,
        node: &Node,
        why: RunReason,
        key: Option<&Key>,
        extent: Option<Extent>,
    ) -> NodePreview {
        NodePreview {
            node: PlannedNode {
                node: node.name.clone(),
                stage: node.def.name.to_owned(),
                state: PlanState::WillRun,
                reason: why.reason,
                key: key.map(|key| key.digest),
                changes: why.changes,
                extent,
                needs: Needs::new(
                    node.bound.as_ref(),
                    node.bound.backend_id().is_some(),
                    self.last_metadata(&node.name).as_ref(),
                ),
            },
            inputs: None,
            listed: None,
            outputs: None,
        }
    }

    /// Returns how the node's last run went.
    fn last_metadata(&self, node: &str) -> Option<RunMetadata> {
        let key = self.last?.latest.get(node)?;
        Some(self.store.record(key).ok()??.metadata)
    }
}

/// Returns the plan of one node.
///
/// # Errors
/// A store that cannot be read, a name that is not in the graph, the wish to stop.
pub fn why(
    graph: &Graph,
    store: &Store,
    last: Option<&RunRecord>,
    options: &PlanOptions<'_>,
    node: &str,
) -> Result<PlannedNode, EngineError> {
    let planned = plan(graph, store, last, options)?.into_iter();
    let mut found = planned.filter(|planned| planned.node == node);
    found.next().ok_or_else(|| EngineError::unknown(graph, node))
}

/// Returns the inputs of a node, or an upstream node whose outputs are not known.
fn inputs_of(node: &Node, known: &[NodePreview]) -> Result<Inputs, usize> {
    let mut inputs = Inputs::default();
    for connection in &node.connections {
        let outputs = known[connection.upstream]
            .outputs
            .as_ref()
            .ok_or(connection.upstream)?;
        let output = outputs.get(connection.source().as_ref());
        inputs
            .0
            .extend(output.map(|digest| (connection.input.clone().into_owned(), *digest)));
    }
    Ok(inputs)
}

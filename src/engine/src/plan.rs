//! The plan: what a run would do, node by node, and why. Lists sources; commits nothing.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};

use marf_cache::{Digest, Store};
use marf_stage::{
    Cancel, Checkpoints, Ctx, Inputs, Listing, Memos, Outputs, Progress, Stage, StageError, Work,
};
use serde::Serialize;

use crate::{
    Change, EngineError, Graph, RunRecord,
    bench::StoreBlobs,
    earlier::{Asks, with_earlier},
    key::{Key, node_key},
    lookup::{Found, Why, because, look_up, outputs_of, why_missed},
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
    /// Why; the first thing that changed.
    pub reason: String,
    /// Its key, as far as its inputs are known.
    pub key: Option<Digest>,
    /// All that changed since it last ran.
    pub changes: Vec<Change>,
}

/// Whether a node would run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PlanState {
    /// Its result is the one of the last run.
    Fresh,
    /// Its result is in the store, though not the one of the last run.
    Cached,
    /// It would run.
    WillRun,
}

/// Tells what a run would do, in topological order. `last` is the last run of this pipeline.
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

/// Tells the same of one node, by name.
///
/// # Errors
/// A store that cannot be read, a name that is not there.
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

fn plan_node(
    graph: &Graph,
    store: &Store,
    last: Option<&RunRecord>,
    index: usize,
    known: &[Option<Outputs>],
) -> Result<(PlannedNode, Option<Outputs>), EngineError> {
    let node = &graph.nodes[index];
    let planned = |state, why: Why, key: Option<&Key>| PlannedNode {
        node: node.name.clone(),
        stage: node.def.name.to_owned(),
        state,
        reason: why.reason,
        key: key.map(|key| key.digest),
        changes: why.changes,
    };
    let mut inputs = Inputs::default();
    for wire in &node.wires {
        let Some(outputs) = &known[wire.upstream] else {
            let reason = format!("upstream {} will run", graph.nodes[wire.upstream].name);
            return Ok((planned(PlanState::WillRun, because(reason), None), None));
        };
        let output = outputs.get(wire.output);
        inputs
            .0
            .extend(output.map(|digest| (wire.output.to_owned(), *digest)));
    }
    let listing = match list(node.bound.as_ref(), store, &Cancel::default(), &Nobody) {
        Ok(listing) => listing,
        Err(error) => {
            let reason = format!("it cannot list what is there: {error}");
            return Ok((planned(PlanState::WillRun, because(reason), None), None));
        }
    };
    let asks = Asks {
        name: &node.name,
        def: &node.def,
        stage: node.bound.as_ref(),
        listing: listing.as_ref(),
    };
    let inputs = with_earlier(store, last, &asks, inputs)?;
    let key = node_key(&node.def, node.bound.as_ref(), &inputs, listing.as_ref());
    let found = look_up(store, &key.digest)?;
    let Found::Hit(record) = found else {
        let mut why = why_missed(store, last, &node.name, &key, &found)?;
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

/// Lists what a source has to offer; none for other stages.
pub(crate) fn list(
    stage: &dyn Stage,
    store: &Store,
    cancel: &Cancel,
    progress: &dyn Progress,
) -> Result<Option<Listing>, StageError> {
    let Work::Source(source) = stage.work() else {
        return Ok(None);
    };
    let ctx = Ctx {
        blobs: &StoreBlobs(store),
        cancel,
        progress,
        checkpoints: &Nobody,
        memos: &Nobody,
        scratch: &store.scratch(),
        threads: 1,
    };
    let listing = catch_unwind(AssertUnwindSafe(|| source.list(&ctx)))
        .unwrap_or_else(|payload| Err(panicked(payload.as_ref())))?;
    let unsorted = listing
        .shards
        .windows(2)
        .find(|pair| pair[0].shard >= pair[1].shard);
    match unsorted {
        Some(pair) => Err(crate::photos::bug(format!(
            "shard {} is listed twice or out of order",
            pair[1].shard
        ))),
        None => Ok(Some(listing)),
    }
}

/// Turns what a panic carries into a failure.
pub(crate) fn panicked(payload: &(dyn std::any::Any + Send)) -> StageError {
    let text = payload.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned());
    StageError::new(format!(
        "panicked: {}",
        text.unwrap_or_else(|| "no message".to_owned())
    ))
    .cause("a panic is a bug of marf, whatever the input")
    .hint("report it with the command and the pipeline")
}

/// Listing keeps no state, and a plan tells nobody how far it is.
struct Nobody;

impl Progress for Nobody {
    fn at(&self, _done: u64, _total: u64, _note: &str) {}
}

impl Checkpoints for Nobody {
    fn load(&self) -> Option<Vec<u8>> {
        None
    }

    fn save(&self, _state: &[u8]) {}
}

impl Memos for Nobody {
    fn load(&self, _key: &Digest) -> Option<Arc<[u8]>> {
        None
    }

    fn save(&self, _key: &Digest, _table: &[u8]) {}
}

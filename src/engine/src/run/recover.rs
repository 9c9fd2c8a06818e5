//! Recovery from a lost blob: the nodes that made it run again, then the node that needs it is tried once more.

use std::collections::BTreeSet;

use marf_cache::Digest;
use marf_stage::StageError;

use super::{
    state::RunState,
    task::{Phase, Reuse, Role},
};
use crate::{event::Event, lookup::is_complete};

/// Attempts at a node in all.
const MAX_TRIES: u32 = 2;

/// Returns the missing or damaged blob, if that is why a node failed and it may be tried again.
pub(super) fn lost_blob(state: &RunState<'_>, index: usize, error: &StageError) -> Option<Digest> {
    let StageError::Blob(blob) = error else {
        return None;
    };
    blob.lost.filter(|_| state.tasks[index].tries < MAX_TRIES)
}

/// Makes the producers of a lost blob run again, and the node after them.
pub(super) fn recover(state: &mut RunState<'_>, index: usize, lost: &Digest) {
    let producers = producers(state, index);
    let names: Vec<String> = producers
        .iter()
        .map(|&producer| format!("`{}`", state.tasks[producer].name))
        .collect();
    let again = match names.is_empty() {
        true => "it is tried again".to_owned(),
        false => format!("{} will run again", names.join(", ")),
    };
    state.context.listener.on_event(&Event::Warning {
        node: Some(state.tasks[index].name.clone()),
        message: format!("blob {} is missing or damaged; {again}", lost.short()),
    });
    let mut before = BTreeSet::new();
    for &producer in &producers {
        let task = &mut state.tasks[producer];
        if task.phase.is_settled() {
            task.phase = Phase::Waiting;
            task.role = Role::Run;
            task.reuse = Reuse::Forbidden;
            task.waits_for.extend(before.iter().copied());
        }
        before.insert(producer);
    }
    start_over(state, index, before);
}

/// Resets a node so that it runs after the given ones.
fn start_over(state: &mut RunState<'_>, index: usize, after: BTreeSet<usize>) {
    for child in std::mem::take(&mut state.tasks[index].children) {
        state.tasks[child].phase = Phase::Replaced;
    }
    let task = &mut state.tasks[index];
    task.phase = Phase::Waiting;
    task.reuse = Reuse::Forbidden;
    task.waits_for.extend(after);
}

/// Returns the upstream nodes with missing blobs, in topological order. If none is known to miss any, returns
/// those directly upstream: a result may name blobs in a form that only its stage reads.
fn producers(state: &RunState<'_>, index: usize) -> BTreeSet<usize> {
    let (graph, store) = (state.context.graph, state.context.store);
    let root = root_of(state, index);
    let mut upstream = graph.with_ancestors(&BTreeSet::from([root]));
    upstream.remove(&root);
    let is_incomplete = |&producer: &usize| {
        let task = &state.tasks[producer];
        !task.phase.is_settled() || !is_complete(store, &task.outcome.outputs)
    };
    let incomplete: BTreeSet<usize> = upstream.iter().copied().filter(is_incomplete).collect();
    let mut children = state.tasks[index].children.iter();
    let child_is_incomplete = children.any(|&child| !is_complete(store, &state.tasks[child].outcome.outputs));
    if !incomplete.is_empty() || child_is_incomplete {
        return incomplete;
    }
    let connections = graph.nodes[root].connections.iter();
    connections.map(|connection| connection.upstream).collect()
}

/// Returns the node of the graph that a node is, or descends from.
fn root_of(state: &RunState<'_>, index: usize) -> usize {
    let mut root = index;
    while let Some(parent) = state.tasks[root].parent {
        root = parent;
    }
    root
}

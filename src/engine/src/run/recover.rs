//! Recovery from a lost blob: the node that stored it runs again, for as little as possible, then the node that needs it
//! is tried once more.

use std::collections::BTreeSet;

use marf_cache::{Digest, Record, Store};
use marf_stage::StageError;

use super::{
    state::RunState,
    task::{InputSource, Phase, Reuse, Role},
};
use crate::{event::Event, work::needs_of};

/// How often the same blob may be lost to one node: the second time its producer has just stored it.
const MAX_LOSSES: u32 = 2;

/// Returns the missing or damaged blob, if that is why a node failed and it may be tried again.
pub(super) fn lost_blob(state: &mut RunState<'_>, index: usize, error: &StageError) -> Option<Digest> {
    let StageError::Blob(blob) = error else {
        return None;
    };
    let lost = blob.lost?;
    let losses = state.tasks[index].lost.entry(lost).or_default();
    *losses += 1;
    (*losses < MAX_LOSSES).then_some(lost)
}

/// Makes the producer of a lost blob run again, and the node after it.
pub(super) fn recover(state: &mut RunState<'_>, index: usize, lost: &Digest) {
    let producers = producers(state, index, lost);
    let names: Vec<String> = producers
        .iter()
        .map(|&producer| format!("`{}`", state.tasks[producer].name))
        .collect();
    let again = if names.is_empty() {
        "it is tried again".to_owned()
    } else {
        format!("{} will run again", names.join(", "))
    };
    state.context.listener.on_event(&Event::Warning {
        node: Some(state.tasks[index].name.clone()),
        message: format!("blob {} is missing or damaged: {again}", lost.short()),
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

/// Returns the first node, in topological order, that stored a blob among those upstream, else among the other children of its parent.
/// Empty if the node itself or one of its children did. If no node is known to have stored it, returns the nodes directly upstream.
fn producers(state: &RunState<'_>, index: usize, lost: &Digest) -> BTreeSet<usize> {
    let (graph, store) = (state.context.graph, state.context.store);
    let has_stored = |task: usize| {
        let key = state.tasks[task].outcome.key;
        let record = key.and_then(|key| store.record(&key).ok().flatten());
        record.is_some_and(|record| stored(store, &record, lost))
    };
    let root = root_of(state, index);
    let mut upstream = graph.with_ancestors(&BTreeSet::from([root]));
    upstream.remove(&root);
    if let Some(&producer) = upstream.iter().find(|&&task| has_stored(task)) {
        return BTreeSet::from([producer]);
    }
    if let Some(sibling) = siblings(state, index, lost).find(|&task| has_stored(task)) {
        return BTreeSet::from([sibling]);
    }
    let mut own = state.tasks[index].children.iter().chain([&index, &root]);
    if own.any(|&task| has_stored(task)) {
        return BTreeSet::new();
    }
    // An action that runs alone has no node of the graph upstream.
    let node = graph.nodes.get(root).into_iter();
    let connections = node.flat_map(|node| &node.connections);
    connections.map(|connection| connection.upstream).collect()
}

/// Returns the other children of a node's parent that did not read the blob themselves: a child may read what those of
/// earlier rounds have stored.
fn siblings<'s>(state: &'s RunState<'_>, index: usize, lost: &'s Digest) -> impl Iterator<Item = usize> {
    let children = state.tasks[index]
        .parent
        .map(|parent| &state.tasks[parent].children);
    let children = children.into_iter().flatten().copied();
    children.filter(move |&task| {
        let has_read = match &state.tasks[task].inputs {
            InputSource::Fixed(inputs) => inputs.0.values().any(|input| input == lost),
            InputSource::Upstream(_) => false,
        };
        task != index && !has_read
    })
}

/// Returns whether a result, or a part of it, stored a blob.
fn stored(store: &Store, record: &Record, lost: &Digest) -> bool {
    let own = |record: &Record| {
        let is_output = record.outputs.values().any(|output| output.digest == *lost);
        is_output
            || record.needs == Some(*lost)
            || needs_of(store, record).is_some_and(|needs| needs.binary_search(lost).is_ok())
    };
    let part = |key: &Digest| store.record(key).ok().flatten().is_some_and(|part| own(&part));
    own(record) || parts_of(store, record).iter().any(part)
}

/// Returns the keys of the parts of a result. Empty if their list cannot be read.
fn parts_of(store: &Store, record: &Record) -> Vec<Digest> {
    let parts = record.parts.as_ref().and_then(|parts| store.set(parts).ok());
    let parts = parts.unwrap_or_default();
    parts.leaves.into_iter().map(|part| part.leaf).collect()
}

/// Returns the node of the graph that a node is, or descends from.
fn root_of(state: &RunState<'_>, index: usize) -> usize {
    let mut root = index;
    while let Some(parent) = state.tasks[root].parent {
        root = parent;
    }
    root
}

//! The results of a run, for its record.

use std::collections::BTreeMap;

use marf_cache::{Digest, Store, StoreError};

use super::{
    state::RunState,
    task::{Phase, Task},
};
use crate::{
    lookup::lasting_counts,
    record::{NodeRun, NodeState, Outcome},
};

/// Returns how the run ended.
pub(super) fn outcome(state: &RunState<'_>) -> Outcome {
    let any = |wanted: fn(Phase) -> bool| state.tasks.iter().any(|task| wanted(task.phase));
    if any(|phase| phase == Phase::Stopped || !phase.is_settled()) {
        return Outcome::Cancelled;
    }
    match any(|phase| matches!(phase, Phase::Failed | Phase::Skipped)) {
        true => Outcome::Failed,
        false => Outcome::Done,
    }
}

/// Returns the nodes in topological order, children after the node that asked for them.
pub(super) fn node_runs(state: &RunState<'_>) -> Result<Vec<NodeRun>, StoreError> {
    let mut runs = Vec::new();
    for index in 0..state.context.graph.nodes.len() {
        add_run(state, index, &mut runs)?;
    }
    Ok(runs)
}

/// Appends a node and its children.
fn add_run(state: &RunState<'_>, index: usize, runs: &mut Vec<NodeRun>) -> Result<(), StoreError> {
    let task = &state.tasks[index];
    if matches!(task.phase, Phase::Absent | Phase::Replaced) {
        return Ok(());
    }
    let parent = task.parent.map(|parent| state.tasks[parent].name.clone());
    runs.push(node_run(task, parent));
    for &child in &task.children {
        add_run(state, child, runs)?;
    }
    add_stored(
        state.context.store,
        &task.name,
        &task.outcome.stored_children,
        runs,
    )
}

/// Appends the children of a node whose result was in the store.
fn add_stored(
    store: &Store,
    parent: &str,
    children: &BTreeMap<String, Digest>,
    runs: &mut Vec<NodeRun>,
) -> Result<(), StoreError> {
    for (name, key) in children {
        let Some(record) = store.record(key)? else {
            continue;
        };
        let name = format!("{parent}/{name}");
        runs.push(NodeRun {
            name: name.clone(),
            stage: record.stage.clone(),
            parent: Some(parent.to_owned()),
            edges: Vec::new(),
            key: Some(*key),
            state: NodeState::Reused,
            reason: format!("{parent} was reused"),
            seconds: record.metadata.seconds,
            counts: lasting_counts(&record),
            outputs: record.outputs.clone(),
        });
        add_stored(store, &name, &record.children, runs)?;
    }
    Ok(())
}

/// Converts the final state of a node.
fn node_run(task: &Task, parent: Option<String>) -> NodeRun {
    let state = match task.phase {
        Phase::Reused => NodeState::Reused,
        Phase::Finished => NodeState::Finished,
        Phase::Failed => NodeState::Failed,
        Phase::Skipped => NodeState::Skipped,
        _ => NodeState::Cancelled,
    };
    NodeRun {
        name: task.name.clone(),
        stage: task.def.name.to_owned(),
        parent,
        edges: task.edges.clone(),
        key: task.outcome.key,
        state,
        reason: task.outcome.reason.clone(),
        seconds: task.outcome.seconds,
        outputs: task.outcome.outputs.clone(),
        counts: task.outcome.counts.clone(),
    }
}

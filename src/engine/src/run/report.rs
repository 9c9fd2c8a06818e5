//! The results of a run, for its record.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{Digest, Record, Store, StoreError};

use super::{
    options::threads,
    state::RunState,
    task::{Phase, Role, Task},
};
use crate::{
    key::action_at,
    lookup::lasting_counts,
    record::{NodeInput, NodeRun, NodeState, Outcome, OutputName, RUN_FORMAT, RunRecord},
};

/// Most levels of children that a record lists below a stored result.
const MOST_DEPTH: usize = 8;

/// Returns the record of a run, which is not stored yet. A run that goes on counts as stopped here.
pub(super) fn record(state: &RunState<'_>) -> Result<RunRecord, StoreError> {
    let context = &state.context;
    let options = context.options;
    let nodes = node_runs(state)?;
    let mut latest = context.last.map(|run| run.latest.clone()).unwrap_or_default();
    let good = nodes.iter().filter(|node| node.state.is_good());
    latest.extend(good.filter_map(|node| Some((node.name.clone(), node.key?))));
    Ok(RunRecord {
        number: 0,
        root: None,
        format: RUN_FORMAT,
        id: options.id.clone(),
        pipeline: options.pipeline.clone(),
        source: options.source.clone(),
        command: options.command.clone(),
        program: options.program.clone(),
        build: options.build.clone(),
        started_unix_s: context.started_unix_s,
        seconds: context.began.elapsed().as_secs_f64(),
        outcome: outcome(state),
        digest: context.graph.digest(),
        threads: threads(options.threads),
        nodes,
        documents: BTreeMap::new(),
        latest,
    })
}

/// Returns how the run ended.
fn outcome(state: &RunState<'_>) -> Outcome {
    let any = |wanted: fn(Phase) -> bool| state.tasks.iter().any(|task| wanted(task.phase));
    if any(|phase| phase == Phase::Stopped || !phase.is_settled()) {
        return Outcome::Cancelled;
    }
    if any(|phase| matches!(phase, Phase::Failed | Phase::Skipped)) {
        Outcome::Failed
    } else {
        Outcome::Done
    }
}

/// Returns the nodes in topological order, children after the node that requested them.
fn node_runs(state: &RunState<'_>) -> Result<Vec<NodeRun>, StoreError> {
    let mut runs = Vec::new();
    for index in 0..state.context.graph.nodes.len() {
        add_run(state, index, &mut runs)?;
    }
    add_inputs(state.context.store, &mut runs)?;
    Ok(runs)
}

/// Adds to each node what its action names as inputs, each with the output that it is.
fn add_inputs(store: &Store, runs: &mut [NodeRun]) -> Result<(), StoreError> {
    for index in 0..runs.len() {
        let (before, rest) = runs.split_at_mut(index);
        let Some((node, _)) = rest.split_first_mut() else {
            break;
        };
        let action = node.key.map(|key| action_at(store, &key)).transpose()?.flatten();
        for (name, digest) in action.into_iter().flat_map(|action| action.inputs) {
            let made_by = maker(before, node, &name, &digest);
            node.inputs.insert(name, NodeInput { digest, made_by });
        }
    }
    Ok(())
}

/// Returns the output that an input of a node is. An output of a connected node comes first, then the input of its parent, then the first
/// output with this content.
fn maker(before: &[NodeRun], node: &NodeRun, name: &str, digest: &Digest) -> Option<OutputName> {
    let of = |maker: &NodeRun, output: &str| OutputName {
        node: maker.name.clone(),
        output: output.to_owned(),
    };
    let upstream = node.edges.iter().find_map(|edge| {
        let maker = before.iter().find(|maker| maker.name == edge.upstream)?;
        // Of an input from several nodes, `output/NODE`, each edge gives its own.
        let name = match name
            .strip_suffix(edge.upstream.as_str())
            .and_then(|output| output.strip_suffix('/'))
        {
            Some(output) => output,
            None => name,
        };
        let source = edge.source(name);
        let output = maker.outputs.get(source.as_ref())?;
        (output.digest == *digest).then(|| of(maker, &source))
    });
    if upstream.is_some() {
        return upstream;
    }
    let parent = before
        .iter()
        .find(|maker| node.parent.as_ref() == Some(&maker.name));
    let inherited = parent.and_then(|parent| parent.inputs.values().find(|input| input.digest == *digest));
    if let Some(input) = inherited {
        return input.made_by.clone();
    }
    before.iter().find_map(|maker| {
        let mut outputs = maker.outputs.iter();
        let (output, _) = outputs.find(|(_, output)| output.digest == *digest)?;
        Some(of(maker, output))
    })
}

/// Appends a node and its children.
fn add_run(state: &RunState<'_>, index: usize, runs: &mut Vec<NodeRun>) -> Result<(), StoreError> {
    let task = &state.tasks[index];
    let is_only_looked_up = task.role == Role::LookUp && !task.phase.is_settled();
    if is_only_looked_up || matches!(task.phase, Phase::Absent | Phase::Replaced) {
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
        &mut Vec::from_iter(task.outcome.key),
        runs,
    )
}

/// Appends the children of a node whose result was in the store. `above` holds the keys of the node and of all nodes above it: a key does
/// not depend on children, so a record that another program wrote may name one of them as a child.
fn add_stored(
    store: &Store,
    parent: &str,
    children: &BTreeMap<String, Digest>,
    above: &mut Vec<Digest>,
    runs: &mut Vec<NodeRun>,
) -> Result<(), StoreError> {
    if above.len() > MOST_DEPTH {
        return Ok(());
    }
    for StoredChild {
        name, key, record, ..
    } in in_order(stored_children(store, children)?)
    {
        if above.contains(&key) {
            continue;
        }
        let name = format!("{parent}/{name}");
        runs.push(NodeRun {
            name: name.clone(),
            stage: record.stage.clone(),
            parent: Some(parent.to_owned()),
            edges: Vec::new(),
            inputs: BTreeMap::new(),
            key: Some(key),
            state: NodeState::Reused,
            reason: format!("{parent} was reused"),
            cause: None,
            hint: None,
            seconds: record.metadata.seconds,
            started_unix_s: Some(record.metadata.started_unix_s),
            counts: lasting_counts(&record),
            outputs: record.outputs.clone(),
        });
        above.push(key);
        add_stored(store, &name, &record.children, above, runs)?;
        above.pop();
    }
    Ok(())
}

/// A child of a node whose result was in the store.
struct StoredChild<'a> {
    name: &'a str,
    key: Digest,
    record: Record,
    /// Its inputs. Empty if its action is lost.
    inputs: BTreeSet<Digest>,
}

/// Returns the children whose records the store has, by name.
fn stored_children<'a>(
    store: &Store,
    children: &'a BTreeMap<String, Digest>,
) -> Result<Vec<StoredChild<'a>>, StoreError> {
    let mut stored = Vec::new();
    for (name, key) in children {
        let Some(record) = store.record(key)? else {
            continue;
        };
        let action = action_at(store, key)?;
        stored.push(StoredChild {
            name,
            key: *key,
            record,
            inputs: action.map_or_else(BTreeSet::new, |action| action.inputs.into_values().collect()),
        });
    }
    Ok(stored)
}

/// Sorts children after those whose outputs they read. Otherwise their order is kept.
fn in_order(mut left: Vec<StoredChild<'_>>) -> Vec<StoredChild<'_>> {
    let mut ordered = Vec::with_capacity(left.len());
    while !left.is_empty() {
        let made: BTreeSet<Digest> = left.iter().flat_map(StoredChild::made).collect();
        let waits = |child: &StoredChild<'_>| !child.inputs.is_disjoint(&made);
        // Equal contents may form a cycle. Any of its children may then come first.
        let (mut free, waiting): (Vec<_>, Vec<_>) = left.into_iter().partition(|child| !waits(child));
        left = waiting;
        if free.is_empty() {
            free.push(left.remove(0));
        }
        ordered.extend(free);
    }
    ordered
}

impl StoredChild<'_> {
    /// Returns the outputs that are not handed through from an input.
    fn made(&self) -> impl Iterator<Item = Digest> {
        let outputs = self.record.outputs.values().map(|output| output.digest);
        outputs.filter(|digest| !self.inputs.contains(digest))
    }
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
        inputs: BTreeMap::new(),
        key: task.outcome.key,
        state,
        reason: task.outcome.reason.clone(),
        cause: task.outcome.cause.clone(),
        hint: task.outcome.hint.clone(),
        seconds: task.outcome.seconds,
        started_unix_s: task.outcome.started_unix_s,
        outputs: task.outcome.outputs.clone(),
        counts: task.outcome.counts.clone(),
    }
}

//! Preparation: gives waiting nodes their inputs and keys, and looks the keys up in the store.

use marf_cache::StoreError;
use marf_stage::Inputs;

use super::{
    state::RunState,
    task::{InputSource, Phase, Reuse, Role, RunInputs},
};
use crate::{
    earlier::KeyRequest,
    event::{Event, NodeProgress},
    key::Key,
    listing::{Inquiry, SourceListing},
    lookup::{Lookup, look_up, lost_output, why_missed},
};

/// Prepares nodes whose upstream nodes have settled, until no such node remains.
pub(super) fn prepare_all(state: &mut RunState<'_>) -> Result<(), StoreError> {
    let mut moved = true;
    while moved {
        moved = false;
        for index in 0..state.tasks.len() {
            let task = &state.tasks[index];
            let has_settled = |&upstream: &usize| state.tasks[upstream].phase.is_settled();
            if task.phase == Phase::Waiting
                && task.waits_for.iter().all(has_settled)
                && !state.context.cancel.is_set()
            {
                prepare(state, index)?;
                moved = true;
            }
        }
    }
    Ok(())
}

/// Collects the inputs of a waiting node, lists its source, and looks the node up.
fn prepare(state: &mut RunState<'_>, index: usize) -> Result<(), StoreError> {
    let context = state.context;
    let inputs = match inputs(state, index) {
        Ok(inputs) => inputs,
        Err(upstream) => {
            block(state, index, upstream);
            return Ok(());
        }
    };
    let task = &state.tasks[index];
    let progress = NodeProgress::new(&task.name, context.listener);
    let ask = || {
        let inquiry = Inquiry {
            store: context.store,
            cancel: context.cancel,
            progress: &progress,
            pool: context.pool,
        };
        let listed = inquiry.list(task.bound.as_ref())?;
        let warnings = listed.iter().flat_map(|listed| &listed.listing.warnings);
        for message in warnings.cloned() {
            let node = Some(task.name.clone());
            context.listener.on_event(&Event::Warning { node, message });
        }
        Ok(listed)
    };
    let outcome = context.graph.listed(&task.name, ask).and_then(|listed| {
        let mut inputs = inputs;
        inputs
            .0
            .extend(listed.iter().flat_map(|listed| listed.inputs.0.clone()));
        let request = KeyRequest {
            table: &context.graph.table,
            executor: context.executor,
            name: &task.name,
            def: &task.def,
            stage: task.bound.as_ref(),
        };
        let (key, inputs) = request.key(context.store, context.last, inputs)?;
        Ok((key, inputs, listed))
    });
    match outcome {
        Ok((key, inputs, listed)) => look_up_node(state, index, key, inputs, listed),
        Err(error) => {
            state.fail(index, error);
            Ok(())
        }
    }
}

/// Looks up the key of a node. A node with a stored result is reused, another one becomes ready.
fn look_up_node(
    state: &mut RunState<'_>,
    index: usize,
    key: Key,
    inputs: Inputs,
    listed: Option<SourceListing>,
) -> Result<(), StoreError> {
    let context = state.context;
    state.tasks[index].outcome.key = Some(key.digest);
    let task = &state.tasks[index];
    let lookup = match task.reuse {
        Reuse::Allowed => look_up(context.store, &key.digest)?,
        Reuse::Forbidden => Lookup::MissingOutput("or a blob behind it".to_owned()),
    };
    if let Lookup::Hit(record) = lookup {
        state.reuse(index, *record);
        return Ok(());
    }
    if task.role == Role::LookUp {
        state.tasks[index].phase = Phase::Absent;
        return Ok(());
    }
    let reason = match task.reuse {
        Reuse::Allowed => {
            let why = match lookup {
                Lookup::MissingOutput(output) => lost_output(&output),
                _ => why_missed(context.store, context.last, &task.name, &key, listed.as_ref())?,
            };
            why.reason
        }
        Reuse::Forbidden => "a blob was missing or damaged".to_owned(),
    };
    let reason = match &listed {
        Some(listed) => listed.listing.noted(&reason),
        None => reason,
    };
    let task = &mut state.tasks[index];
    task.outcome.reason.clone_from(&reason);
    task.prepared = Some(RunInputs {
        key,
        inputs,
        listed,
        reason,
    });
    task.phase = Phase::Ready;
    Ok(())
}

/// Returns the inputs of a node, or the upstream node that has no outputs.
fn inputs(state: &RunState<'_>, index: usize) -> Result<Inputs, usize> {
    let connections = match &state.tasks[index].inputs {
        InputSource::Fixed(inputs) => return Ok(inputs.clone()),
        InputSource::Upstream(connections) => connections,
    };
    let mut inputs = Inputs::default();
    for connection in connections {
        let upstream = &state.tasks[connection.upstream];
        if !upstream.phase.is_good() {
            return Err(connection.upstream);
        }
        let output = upstream.outcome.outputs.get(connection.source().as_ref());
        inputs
            .0
            .extend(output.map(|output| (connection.input.clone().into_owned(), output.digest)));
    }
    Ok(inputs)
}

/// Stops or skips a node whose upstream node has no outputs.
fn block(state: &mut RunState<'_>, index: usize, by: usize) {
    let upstream = &state.tasks[by];
    let reason = match upstream.phase {
        Phase::Stopped => {
            state.tasks[index].phase = Phase::Stopped;
            return;
        }
        Phase::Failed => format!("{} failed", upstream.name),
        Phase::Absent => format!(
            "{} is not among the nodes to run and has no stored result",
            upstream.name
        ),
        _ => format!("{} was skipped", upstream.name),
    };
    state.skip(index, reason);
}

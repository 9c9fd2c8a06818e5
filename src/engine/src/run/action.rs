//! One action, computed without its pipeline.

use std::{collections::BTreeSet, sync::Arc, time::Instant};

use marf_cache::{Action, Digest, Record, Store, StoreError};
use marf_stage::{Cancel, Inputs, Stage, StageDef};
use serde_json::Value;

use super::{
    Options,
    context::RunContext,
    part::{PartJob, part_of, pass_of},
    pool,
    scheduler::Scheduler,
    state::RunState,
    task::{InputSource, Phase, Prepared, Task},
    threads,
};
use crate::{
    check::GraphError,
    event::Listener,
    graph::Graph,
    items::ShardLeaves,
    key::{differences, node_key},
    record::EngineError,
    work::{PASS, PartKind, part_key},
};

/// Why an action was not computed.
#[derive(Debug, thiserror::Error)]
pub enum ActionError {
    /// No stage of this program has the name.
    #[error("stage `{stage}`, which this program does not have")]
    NoStage {
        /// Its name.
        stage: String,
    },
    /// The action is of a part of a node that the stage does not have.
    #[error("part `{part}` of stage `{stage}`, which this program does not make with these parameters")]
    Part {
        /// Name of the stage.
        stage: String,
        /// Name of the part.
        part: String,
    },
    /// The stage reads an archive, which the machine that plans does.
    #[error("stage `{stage}`, which reads an archive, where the run was planned")]
    Source {
        /// Name of the stage.
        stage: String,
    },
    /// The stage refuses the parameters.
    #[error("stage `{stage}`: {message}")]
    Params {
        /// Name of the stage.
        stage: String,
        /// Which, and why.
        message: String,
    },
    /// The action wants another backend than this machine has.
    #[error("stage `{stage}` on {wanted}, and here is {here}")]
    Backend {
        /// Name of the stage.
        stage: String,
        /// The backend of the action.
        wanted: String,
        /// The backend that this machine would use.
        here: String,
    },
    /// This program makes another key of the action.
    #[error("stage `{stage}` of another marf: {difference}; this program would make the key {key} of it", key = key.short())]
    Key {
        /// Name of the stage.
        stage: String,
        /// The first difference.
        difference: String,
        /// The key that this program makes.
        key: Digest,
    },
    /// The work failed; the listener was told why.
    #[error("{0}")]
    Failed(String),
    /// The user wanted to stop.
    #[error("stopped")]
    Stopped,
    /// Threads, or a bad table of stages.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// A table of stages that no graph can have.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// The store cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Computes an action in a store that has its inputs, and returns its record; the record that is there already, if one is. `params` are
/// those of the action with what is in no key (a device), `table` has all stages.
///
/// The key is made again from what this program would do: a result is never stored under a key that it does not belong to.
///
/// # Errors
/// An action that this program or this machine would make otherwise, work that failed, a store that cannot be used.
pub fn run_action(
    (action, params): (&Action, Value),
    table: &[StageDef],
    store: &Store,
    options: &Options,
    listener: &dyn Listener,
    cancel: &Cancel,
) -> Result<Record, ActionError> {
    let graph = Graph::new(Vec::new(), table)?;
    let (task, part) = task_of(action, params, &graph)?;
    let threads = threads(options.threads);
    let pool = pool(threads)?;
    if let Some((kind, shard)) = part {
        let part = PartJob {
            task: &task,
            kind,
            shard,
            store,
            program: &options.program,
            threads,
        };
        return pool.install(|| part.run(listener, cancel));
    }
    let context = RunContext {
        graph: &graph,
        store,
        listener,
        cancel,
        pool: &pool,
        program: &options.program,
        last: None,
        executor: None,
        began: Instant::now(),
        shared: None,
    };
    let mut state = RunState::new(context, Vec::new(), &BTreeSet::new());
    state.tasks.push(task);
    let state = Scheduler::new(state, threads).run()?;
    store.commit()?;
    let task = &state.tasks[0];
    let lost = || ActionError::Failed("its result was lost".to_owned());
    match task.phase {
        phase if phase.is_good() => store.record(&action.key())?.ok_or_else(lost),
        Phase::Stopped => Err(ActionError::Stopped),
        _ => Err(ActionError::Failed(task.outcome.reason.clone())),
    }
}

/// Returns the task of an action, if this program on this machine would make the same key of it, and which part of its node it is; none
/// if it is the node.
fn task_of(
    action: &Action,
    mut params: Value,
    graph: &Graph,
) -> Result<(Task, Option<(PartKind, ShardLeaves)>), ActionError> {
    let stage = || action.stage.clone();
    let Some(def) = graph.table.get(action.stage.as_str()) else {
        return Err(ActionError::NoStage { stage: stage() });
    };
    // Nothing else has no inputs.
    if def.ports.is_empty() {
        return Err(ActionError::Source { stage: stage() });
    }
    if pass_of(action).is_some() {
        // A summary depends on no other parameter, so those that its stage has by default do.
        params.as_object_mut().map(|params| params.remove(PASS));
    }
    let bound: Arc<dyn Stage> = (def.bind)(params)
        .map_err(|error| ActionError::Params {
            stage: stage(),
            message: error.to_string(),
        })?
        .into();
    let part = match &action.part {
        None => None,
        Some(name) => {
            let unknown = || ActionError::Part {
                stage: stage(),
                part: name.clone(),
            };
            Some(part_of(action, bound.as_ref()).ok_or_else(unknown)?)
        }
    };
    let inputs = Inputs(action.inputs.clone());
    let mut key = node_key((&graph.table, None), def, bound.as_ref(), &inputs)
        .map_err(|error| ActionError::Failed(error.to_string()))?;
    if let Some((kind, (shard, _))) = &part {
        key = part_key(&key.action, *kind, *shard, inputs.0.clone());
    }
    let here = &key.action;
    let backend = |action: &Action| action.backend.clone().unwrap_or_else(|| "cpu".to_owned());
    if here.backend != action.backend {
        return Err(ActionError::Backend {
            stage: stage(),
            wanted: backend(action),
            here: backend(here),
        });
    }
    if key.digest != action.key() {
        let differences = differences(action, here);
        return Err(ActionError::Key {
            stage: stage(),
            difference: differences.first().map(ToString::to_string).unwrap_or_default(),
            key: key.digest,
        });
    }
    let prepared = Prepared {
        key,
        inputs: inputs.clone(),
        listed: None,
        reason: String::new(),
    };
    let task = Task {
        prepared: Some(prepared),
        ..Task::new(stage(), *def, bound, InputSource::Fixed(inputs))
    };
    Ok((task, part))
}

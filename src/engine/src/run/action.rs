//! One action, computed without its pipeline.

use std::{collections::BTreeSet, sync::Arc, time::Instant};

use marf_cache::{Action, Digest, Record, Store};
use marf_stage::{Cancel, Inputs, Stage, StageDef};
use serde_json::Value;

use super::{
    context::RunContext,
    error::ActionError,
    job::unix_seconds,
    options::Options,
    pool,
    scheduler::Scheduler,
    state::RunState,
    task::{InputSource, Phase, RunInputs, Task},
    threads,
};
use crate::{
    event::Listener,
    graph::Graph,
    key::{differences, node_key},
    state_listener::EventsOnly,
};

/// An action that this program on this machine computes under the same key.
pub struct ActionJob {
    graph: Graph,
    task: Task,
    key: Digest,
}

impl ActionJob {
    /// Checks an action. `params` are those of the action with keys that are not in its key (a device), `table` has all stages.
    ///
    /// The key is computed again from the stage of this program, so that a result is never stored under a wrong key.
    ///
    /// # Errors
    /// An action for which this program or this machine has another key.
    pub fn new(action: &Action, params: Value, table: &[StageDef]) -> Result<Self, ActionError> {
        let graph = Graph::new(Vec::new(), table)?;
        let task = task_of(action, params, &graph)?;
        Ok(Self {
            graph,
            task,
            key: action.key(),
        })
    }

    /// Computes the action in a store that has its inputs, and returns its record. A stored record is returned as it is.
    ///
    /// # Errors
    /// Work that failed, a store that cannot be used.
    pub fn run(
        self,
        store: &Store,
        options: &Options,
        listener: &dyn Listener,
        cancel: &Cancel,
    ) -> Result<Record, ActionError> {
        let threads = threads(options.threads);
        let pool = pool(threads)?;
        let context = RunContext {
            graph: &self.graph,
            store,
            listener: &EventsOnly(listener),
            cancel,
            pool: &pool,
            options,
            last: None,
            executor: None,
            began: Instant::now(),
            started_unix_s: unix_seconds(),
            shared: None,
        };
        let mut state = RunState::new(context, Vec::new(), &BTreeSet::new());
        state.tasks.push(self.task);
        let state = Scheduler::new(state, threads).run()?;
        store.commit()?;
        let task = &state.tasks[0];
        let lost = || ActionError::Failed("its result was lost".to_owned());
        match task.phase {
            phase if phase.is_good() => store.record(&self.key)?.ok_or_else(lost),
            Phase::Stopped => Err(ActionError::Stopped),
            _ => Err(ActionError::Failed(task.outcome.reason.clone())),
        }
    }
}

/// Returns the task of an action, if this program on this machine computes the same key for it.
fn task_of(action: &Action, params: Value, graph: &Graph) -> Result<Task, ActionError> {
    let stage = &action.stage;
    let elsewhere = |message: String| Err(ActionError::Elsewhere(message));
    let Some(def) = graph.table.get(action.stage.as_str()) else {
        return elsewhere(format!("stage `{stage}`, which this program does not have"));
    };
    // Nothing else has no inputs.
    if def.ports.is_empty() {
        return Err(ActionError::Source { stage: stage.clone() });
    }
    if let Some(part) = &action.part {
        return Err(ActionError::Part {
            part: part.clone(),
            stage: stage.clone(),
        });
    }
    let bound: Arc<dyn Stage> = (def.bind)(params)
        .map_err(|error| ActionError::Elsewhere(format!("stage `{stage}`: {error}")))?
        .into();
    let inputs = Inputs(action.inputs.clone());
    let key = node_key(&graph.table, None, def, bound.as_ref(), &inputs)
        .map_err(|error| ActionError::Failed(error.to_string()))?;
    let here = &key.action;
    let backend = |action: &Action| action.backend.clone().unwrap_or_else(|| "cpu".to_owned());
    if here.backend != action.backend {
        let (wanted, here) = (backend(action), backend(here));
        return elsewhere(format!("stage `{stage}` on {wanted}, and here is {here}"));
    }
    if key.digest != action.key() {
        let differences = differences(action, here);
        let difference = differences.first().map(ToString::to_string).unwrap_or_default();
        return elsewhere(format!(
            "stage `{stage}` of another marf: {difference}. This program would give it the key {}",
            key.digest.short()
        ));
    }
    let prepared = RunInputs {
        key,
        inputs: inputs.clone(),
        listed: None,
        reason: String::new(),
    };
    Ok(Task {
        prepared: Some(prepared),
        ..Task::new(stage.clone(), *def, bound, InputSource::Fixed(inputs))
    })
}

//! The state of a run: its nodes, and what happens to them.

use std::{collections::BTreeSet, sync::Arc};

use marf_cache::Record;
use marf_stage::{NodeSpec, StageError};

use super::{
    context::RunContext,
    task::{InputSource, Phase, Reuse, Role, Task},
};
use crate::{errors::contract_violation, event::Event, lookup::lasting_counts};

/// The nodes of a run. Those of the graph come first, in its order. Children follow in the order of the requests.
pub(super) struct RunState<'a> {
    pub(super) context: RunContext<'a>,
    pub(super) tasks: Vec<Task>,
}

impl<'a> RunState<'a> {
    /// Returns the state before anything has run, with one role for each node of the graph. Nodes of `lost` do not use their stored
    /// results.
    pub(super) fn new(context: RunContext<'a>, roles: Vec<Role>, lost: &BTreeSet<usize>) -> Self {
        let nodes = context.graph.nodes.iter().zip(roles);
        let mut tasks: Vec<Task> = nodes.map(|(node, role)| Task::of_node(node, role)).collect();
        for &index in lost {
            tasks[index].reuse = Reuse::Forbidden;
        }
        Self { context, tasks }
    }

    /// Gives a node the result that the store has for its key.
    pub(super) fn reuse(&mut self, index: usize, record: Record) {
        let is_last = self
            .context
            .last
            .is_some_and(|run| run.latest.get(&self.tasks[index].name) == Some(&record.key));
        let reason = if is_last {
            "nothing changed"
        } else {
            "its result is in the store"
        };
        let counts = lasting_counts(&record);
        let task = &mut self.tasks[index];
        task.phase = Phase::Reused;
        task.outcome.reason = reason.to_owned();
        task.outcome.seconds = record.metadata.seconds;
        task.outcome.started_unix_s = Some(record.metadata.started_unix_s);
        task.outcome.counts = counts;
        task.outcome.outputs = record.outputs;
        task.outcome.stored_children = record.children;
        if task.role == Role::Run {
            self.context.listener.on_event(&Event::Reused {
                node: task.name.clone(),
                reason: reason.to_owned(),
            });
        }
        self.child_settled(index);
    }

    /// Gives a node the result of its job.
    pub(super) fn finish(&mut self, index: usize, record: Record) {
        let task = &mut self.tasks[index];
        task.phase = Phase::Finished;
        task.outcome.key = Some(record.key);
        task.outcome.seconds = record.metadata.seconds;
        task.outcome.started_unix_s = Some(record.metadata.started_unix_s);
        task.outcome.outputs = record.outputs;
        task.outcome.counts = record.metadata.counts;
        self.context.listener.on_event(&Event::Finished {
            node: task.name.clone(),
            seconds: task.outcome.seconds,
            outputs: task.outcome.outputs.clone(),
            counts: task.outcome.counts.clone(),
        });
        self.child_settled(index);
    }

    /// Marks a node as not run for this reason.
    pub(super) fn skip(&mut self, index: usize, reason: String) {
        let task = &mut self.tasks[index];
        if task.role == Role::LookUp {
            task.phase = Phase::Absent;
            return;
        }
        task.phase = Phase::Skipped;
        task.outcome.reason.clone_from(&reason);
        let node = task.name.clone();
        self.context.listener.on_event(&Event::Skipped { node, reason });
        self.child_settled(index);
    }

    /// Marks a node as failed, or as stopped if it was cancelled.
    pub(super) fn fail(&mut self, index: usize, error: StageError) {
        let task = &mut self.tasks[index];
        let node = task.name.clone();
        let (message, cause, hint) = match error {
            StageError::Cancelled => {
                task.phase = Phase::Stopped;
                self.child_settled(index);
                return;
            }
            StageError::Failed { message, cause, hint } => (message, cause, hint),
            StageError::Blob(error) => (error.message, None, None),
        };
        task.phase = Phase::Failed;
        task.outcome.reason.clone_from(&message);
        task.outcome.cause.clone_from(&cause);
        task.outcome.hint.clone_from(&hint);
        self.context.listener.on_event(&Event::Failed {
            node,
            message,
            cause,
            hint,
        });
        self.child_settled(index);
    }

    /// Prepares a node for its first step. Children that an earlier try requested are detached from it.
    pub(super) fn begin(&mut self, index: usize) {
        for child in std::mem::take(&mut self.tasks[index].children) {
            self.tasks[child].phase = Phase::Replaced;
        }
        self.tasks[index].began = None;
    }

    /// Adds a round of children to a node.
    pub(super) fn expand(&mut self, index: usize, specs: Vec<NodeSpec>) {
        let mut children = Vec::new();
        let earlier = self.tasks[index].children.iter();
        let mut names: BTreeSet<String> = earlier.map(|&child| self.tasks[child].name.clone()).collect();
        for spec in specs {
            match self.child(index, spec) {
                Ok(child) if names.insert(child.name.clone()) => children.push(child),
                Ok(child) => {
                    let message = format!("it asks for `{}` twice", child.name);
                    return self.fail(index, contract_violation(message));
                }
                Err(error) => return self.fail(index, error),
            }
        }
        let first = self.tasks.len();
        self.tasks[index].children.extend(first..first + children.len());
        self.tasks[index].phase = if children.is_empty() {
            Phase::Reducible
        } else {
            Phase::Expanding
        };
        self.tasks.extend(children);
    }

    /// Returns the task of a child, with its stage looked up and its parameters checked.
    fn child(&self, parent: usize, spec: NodeSpec) -> Result<Task, StageError> {
        let name = format!("{}/{}", self.tasks[parent].name, spec.name);
        let Some(def) = self.context.graph.table.get(spec.stage.as_str()) else {
            return Err(contract_violation(format!(
                "`{name}` is of the stage `{}`, which does not exist",
                spec.stage
            )));
        };
        let bound = (def.bind)(spec.params).map_err(|error| {
            let path = if error.path.is_empty() {
                name.clone()
            } else {
                format!("{name}.{}", error.path)
            };
            StageError::new(format!("`{path}`: {error}"))
        })?;
        Ok(Task {
            parent: Some(parent),
            ..Task::new(name, *def, Arc::from(bound), InputSource::Fixed(spec.inputs))
        })
    }

    /// Reports progress of the parent of a settled child. After the last child the parent continues.
    fn child_settled(&mut self, index: usize) {
        let Some(parent) = self.tasks[index].parent else {
            return;
        };
        if self.tasks[parent].phase != Phase::Expanding {
            return;
        }
        let phases: Vec<Phase> = self.tasks[parent]
            .children
            .iter()
            .map(|&child| self.tasks[child].phase)
            .collect();
        let settled = phases.iter().filter(|phase| phase.is_settled()).count();
        self.context.listener.on_event(&Event::Progress {
            node: self.tasks[parent].name.clone(),
            done: settled as u64,
            total: phases.len() as u64,
            note: String::new(),
        });
        if settled < phases.len() {
            return;
        }
        let bad: Vec<usize> = (0..phases.len())
            .filter(|&child| !phases[child].is_good())
            .collect();
        let failed = bad.iter().find(|&&child| phases[child] == Phase::Failed);
        match failed.or(bad.first()) {
            None => self.tasks[parent].phase = Phase::Reducible,
            Some(_) if phases.contains(&Phase::Stopped) => self.fail(parent, StageError::Cancelled),
            Some(&first) => {
                let child = &self.tasks[self.tasks[parent].children[first]];
                let message = format!(
                    "{} of {} of its nodes failed, first `{}`",
                    bad.len(),
                    phases.len(),
                    child.name
                );
                let error = StageError::Failed {
                    message,
                    cause: Some(child.outcome.why()),
                    hint: child.outcome.hint.clone(),
                };
                self.fail(parent, error);
            }
        }
    }

    /// Marks every node that has not settled as stopped.
    pub(super) fn mark_stopped(&mut self) {
        for task in self.tasks.iter_mut().filter(|task| task.role == Role::Run) {
            if task.phase == Phase::Stopped || !task.phase.is_settled() {
                task.phase = Phase::Stopped;
                task.outcome.reason = "the run was stopped".to_owned();
                self.context.listener.on_event(&Event::Skipped {
                    node: task.name.clone(),
                    reason: task.outcome.reason.clone(),
                });
            }
        }
    }
}

//! What the run record tells.

use std::collections::BTreeMap;

use marf_cache::{Digest, StoreError};

use super::{
    Floor,
    task::{Phase, Task},
};
use crate::{NodeRun, NodeState, Outcome, lookup::counts_of};

impl Floor<'_> {
    pub(super) fn outcome(&self) -> Outcome {
        let any = |wanted: fn(Phase) -> bool| self.tasks.iter().any(|task| wanted(task.phase));
        if any(|phase| phase == Phase::Stopped || !phase.is_settled()) {
            return Outcome::Cancelled;
        }
        match any(|phase| matches!(phase, Phase::Failed | Phase::Skipped)) {
            true => Outcome::Failed,
            false => Outcome::Done,
        }
    }

    /// Returns the nodes in topological order, children after the node that asked for them.
    pub(super) fn node_runs(&self) -> Result<Vec<NodeRun>, StoreError> {
        let mut runs = Vec::new();
        for index in 0..self.site.graph.nodes.len() {
            self.add_run(index, &mut runs)?;
        }
        Ok(runs)
    }

    fn add_run(&self, index: usize, runs: &mut Vec<NodeRun>) -> Result<(), StoreError> {
        let task = &self.tasks[index];
        if matches!(task.phase, Phase::Absent | Phase::Replaced) {
            return Ok(());
        }
        let parent = task.parent.map(|parent| self.tasks[parent].name.clone());
        runs.push(node_run(task, parent));
        for &child in &task.children {
            self.add_run(child, runs)?;
        }
        self.add_stored(&task.name, &task.told.children, runs)
    }

    /// Adds the children of a node whose result was in the store.
    fn add_stored(
        &self,
        parent: &str,
        children: &BTreeMap<String, Digest>,
        runs: &mut Vec<NodeRun>,
    ) -> Result<(), StoreError> {
        for (name, key) in children {
            let Some(record) = self.site.store.record(key)? else {
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
                counts: counts_of(self.site.store, &record),
                outputs: record.outputs.clone(),
            });
            self.add_stored(&name, &record.children, runs)?;
        }
        Ok(())
    }
}

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
        key: task.told.key,
        state,
        reason: task.told.reason.clone(),
        seconds: task.told.seconds,
        outputs: task.told.outputs.clone(),
        counts: task.told.counts.clone(),
    }
}

//! From waiting to ready: inputs, key, and a look into the store.

use marf_cache::{Record, StoreError};
use marf_stage::{Inputs, StageError};

use super::{
    Floor,
    task::{Feed, Order, Phase, Role, Trust},
};
use crate::{
    Event,
    earlier::{Asks, with_earlier},
    event::NodeProgress,
    key::node_key,
    lookup::{Found, counts_of, look_up, why_missed},
    plan::list,
};

impl Floor<'_> {
    /// Moves on every node whose upstream nodes have settled, until none moves any more.
    pub(super) fn prepare_all(&mut self) -> Result<(), StoreError> {
        let mut moved = true;
        while moved {
            moved = false;
            for index in 0..self.tasks.len() {
                let task = &self.tasks[index];
                let can = |&wait: &usize| self.tasks[wait].phase.is_settled();
                if task.phase == Phase::Waiting && task.waits.iter().all(can) && !self.site.cancel.is_set() {
                    self.prepare(index)?;
                    moved = true;
                }
            }
        }
        Ok(())
    }

    fn prepare(&mut self, index: usize) -> Result<(), StoreError> {
        let inputs = match self.inputs(index) {
            Ok(inputs) => inputs,
            Err(blocked) => {
                self.block(index, blocked);
                return Ok(());
            }
        };
        let task = &self.tasks[index];
        let progress = NodeProgress::new(&task.name, self.site.listener);
        let listing = match list(task.bound.as_ref(), self.site.store, self.site.cancel, &progress) {
            Ok(listing) => listing,
            Err(error) => {
                self.fail(index, error);
                return Ok(());
            }
        };
        let asks = Asks {
            name: &task.name,
            def: &task.def,
            stage: task.bound.as_ref(),
            listing: listing.as_ref(),
        };
        let inputs = with_earlier(self.site.store, self.site.last, &asks, inputs)?;
        let key = node_key(&task.def, task.bound.as_ref(), &inputs, listing.as_ref());
        self.tasks[index].told.key = Some(key.digest);
        let task = &self.tasks[index];
        let found = match task.trust {
            Trust::Stored => look_up(self.site.store, &key.digest)?,
            Trust::Nothing => Found::Lost("or a blob behind it".to_owned()),
        };
        if let Found::Hit(record) = found {
            self.reuse(index, *record);
            return Ok(());
        }
        if task.role == Role::LookUp {
            self.tasks[index].phase = Phase::Absent;
            return Ok(());
        }
        let reason = match task.trust {
            Trust::Stored => why_missed(self.site.store, self.site.last, &task.name, &key, &found)?.reason,
            Trust::Nothing => "a blob was missing or damaged".to_owned(),
        };
        let reason = listing
            .as_ref()
            .map_or(reason.clone(), |listing| listing.noted(&reason));
        let task = &mut self.tasks[index];
        task.told.reason.clone_from(&reason);
        task.order = Some(Order {
            key,
            inputs,
            listing,
            reason,
        });
        task.phase = Phase::Ready;
        Ok(())
    }

    /// Returns the inputs, or the upstream node that does not give them.
    fn inputs(&self, index: usize) -> Result<Inputs, usize> {
        let wires = match &self.tasks[index].feed {
            Feed::Fixed(inputs) => return Ok(inputs.clone()),
            Feed::Wires(wires) => wires,
        };
        let mut inputs = Inputs::default();
        for wire in wires {
            let upstream = &self.tasks[wire.upstream];
            if !upstream.phase.is_good() {
                return Err(wire.upstream);
            }
            let output = upstream.told.outputs.get(wire.output);
            inputs
                .0
                .extend(output.map(|output| (wire.output.to_owned(), output.digest)));
        }
        Ok(inputs)
    }

    fn block(&mut self, index: usize, by: usize) {
        let upstream = &self.tasks[by];
        let reason = match upstream.phase {
            Phase::Stopped => {
                self.tasks[index].phase = Phase::Stopped;
                return;
            }
            Phase::Failed => format!("{} failed", upstream.name),
            Phase::Absent => format!(
                "{} is not among the nodes to run and has no stored result",
                upstream.name
            ),
            _ => format!("{} was skipped", upstream.name),
        };
        self.skip(index, reason);
    }

    pub(super) fn skip(&mut self, index: usize, reason: String) {
        let task = &mut self.tasks[index];
        if task.role == Role::LookUp {
            task.phase = Phase::Absent;
            return;
        }
        task.phase = Phase::Skipped;
        task.told.reason.clone_from(&reason);
        let node = task.name.clone();
        self.site.listener.on_event(&Event::Skipped { node, reason });
        self.child_settled(index);
    }

    /// Takes a stored result.
    pub(super) fn reuse(&mut self, index: usize, record: Record) {
        let is_last = self
            .site
            .last
            .is_some_and(|run| run.latest.get(&self.tasks[index].name) == Some(&record.key));
        let reason = match is_last {
            true => "nothing changed",
            false => "its result is in the store",
        };
        let counts = counts_of(self.site.store, &record);
        let task = &mut self.tasks[index];
        task.phase = Phase::Reused;
        task.told.reason = reason.to_owned();
        task.told.seconds = record.metadata.seconds;
        task.told.counts = counts;
        task.told.outputs = record.outputs;
        task.told.children = record.children;
        if task.role == Role::Run {
            self.site.listener.on_event(&Event::Reused {
                node: task.name.clone(),
                reason: reason.to_owned(),
            });
        }
        self.child_settled(index);
    }

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
        task.told.reason.clone_from(&message);
        self.site.listener.on_event(&Event::Failed {
            node,
            message,
            cause,
            hint,
        });
        self.child_settled(index);
    }
}

//! A blob that a node needs is lost: who made it runs again, then the node is tried once more.

use std::collections::BTreeSet;

use marf_cache::Digest;
use marf_stage::StageError;

use super::{
    Floor,
    task::{Phase, Role, Trust},
};
use crate::{Event, lookup::is_whole};

/// A node is tried this often in all.
const MOST_TRIES: u32 = 2;

impl Floor<'_> {
    /// Returns the blob that is missing or damaged, if that is why a node failed and it may be tried again.
    pub(super) fn can_heal(&self, index: usize, error: &StageError) -> Option<Digest> {
        let StageError::Blob(blob) = error else {
            return None;
        };
        blob.lost.filter(|_| self.tasks[index].tries < MOST_TRIES)
    }

    pub(super) fn heal(&mut self, index: usize, lost: &Digest) {
        let makers = self.makers(index);
        let names: Vec<String> = makers
            .iter()
            .map(|&maker| format!("`{}`", self.tasks[maker].name))
            .collect();
        let again = match names.is_empty() {
            true => "it is tried again".to_owned(),
            false => format!("{} will run again", names.join(", ")),
        };
        self.site.listener.on_event(&Event::Warning {
            node: Some(self.tasks[index].name.clone()),
            message: format!("blob {} is missing or damaged; {again}", lost.short()),
        });
        let mut earlier = BTreeSet::new();
        for &maker in &makers {
            let task = &mut self.tasks[maker];
            if task.phase.is_settled() {
                task.phase = Phase::Waiting;
                task.role = Role::Run;
                task.trust = Trust::Nothing;
                task.waits.extend(earlier.iter().copied());
            }
            earlier.insert(maker);
        }
        self.start_over(index, earlier);
    }

    fn start_over(&mut self, index: usize, waits: BTreeSet<usize>) {
        for child in std::mem::take(&mut self.tasks[index].children) {
            self.tasks[child].phase = Phase::Replaced;
        }
        let task = &mut self.tasks[index];
        task.phase = Phase::Waiting;
        task.trust = Trust::Nothing;
        task.waits.extend(waits);
    }

    /// Returns the nodes whose results are not whole, in topological order; if all seem whole, those directly
    /// above, as a result may name blobs in a way only its stage knows.
    fn makers(&self, index: usize) -> BTreeSet<usize> {
        let top = self.top_of(index);
        let mut above = self.site.graph.with_ancestors(&BTreeSet::from([top]));
        above.remove(&top);
        let is_broken = |&maker: &usize| {
            let task = &self.tasks[maker];
            !task.phase.is_settled() || !is_whole(self.site.store, &task.told.outputs)
        };
        let broken: BTreeSet<usize> = above.iter().copied().filter(is_broken).collect();
        let mut own = self.tasks[index].children.iter();
        let own_broken = own.any(|&child| !is_whole(self.site.store, &self.tasks[child].told.outputs));
        if !broken.is_empty() || own_broken {
            return broken;
        }
        let wires = self.site.graph.nodes[top].wires.iter();
        wires.map(|wire| wire.upstream).collect()
    }

    /// Returns the node of the graph that this one is or descends from.
    fn top_of(&self, index: usize) -> usize {
        let mut top = index;
        while let Some(parent) = self.tasks[top].parent {
            top = parent;
        }
        top
    }
}

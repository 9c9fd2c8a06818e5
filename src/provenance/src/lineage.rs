//! A run as the store has it: nodes with their actions and records, inputs with the outputs that they are.

use std::collections::BTreeSet;

use marf_cache::{Action, Digest, Record, Store};
use marf_engine::{NodeRun, RunRecord, action_at, run_of, trace_inputs};

use crate::LineageError;

/// A run and what the store has of its nodes.
pub struct Lineage<'s> {
    store: &'s Store,
    /// The run root.
    pub run: RunRecord,
    /// The nodes in topological order, the children of a node after it.
    pub nodes: Vec<NodeLineage>,
}

/// A node of a run and what the store has of its result.
#[derive(Debug, Clone)]
pub struct NodeLineage {
    /// What the run root says of it: name, key, edges, inputs, outputs, times.
    pub run: NodeRun,
    /// Everything its result depends on; none if the node has no result, or the store has lost the action.
    pub action: Option<Action>,
    /// Its record: outputs, needs, parts, children, device and time; none if it is not in the store.
    pub record: Option<Record>,
}

impl<'s> Lineage<'s> {
    /// Reads a run by its number.
    ///
    /// # Errors
    /// A run that cannot be read, or a store that cannot. What the store has lost of a node is no error.
    pub fn open(store: &'s Store, number: u64) -> Result<Self, LineageError> {
        Self::of(store, run_of(store, number)?)
    }

    /// Reads what the store has of a run's nodes.
    ///
    /// # Errors
    /// A store that cannot be read.
    pub fn of(store: &'s Store, mut run: RunRecord) -> Result<Self, LineageError> {
        trace_inputs(store, &mut run)?;
        let node = |run: &NodeRun| -> Result<NodeLineage, LineageError> {
            let action = run.key.map(|key| action_at(store, &key)).transpose()?;
            let record = run.key.map(|key| store.record(&key)).transpose()?;
            Ok(NodeLineage {
                run: run.clone(),
                action: action.flatten(),
                record: record.flatten(),
            })
        };
        let nodes = run.nodes.iter().map(node).collect::<Result<_, _>>()?;
        Ok(Self { store, run, nodes })
    }

    /// Returns the store.
    pub fn store(&self) -> &'s Store {
        self.store
    }

    /// Returns a node by its name.
    pub fn node(&self, name: &str) -> Option<&NodeLineage> {
        self.nodes.iter().find(|node| node.run.name == name)
    }

    /// Returns a node, the nodes that made its inputs and their children, and so on up to the sources, in topological
    /// order.
    pub fn upstream(&self, name: &str) -> Vec<&NodeLineage> {
        let mut wanted = BTreeSet::from([name.to_owned()]);
        // Nodes come after those they read and before their children, so that one way back finds all but the children.
        loop {
            let before = wanted.len();
            for node in &self.nodes {
                let of_wanted = node
                    .run
                    .parent
                    .as_ref()
                    .is_some_and(|parent| wanted.contains(parent));
                if of_wanted {
                    wanted.insert(node.run.name.clone());
                }
                if wanted.contains(&node.run.name) {
                    let makers = node
                        .run
                        .inputs
                        .values()
                        .filter_map(|input| input.made_by.as_ref());
                    wanted.extend(makers.map(|made_by| made_by.node.clone()));
                }
            }
            if wanted.len() == before {
                break;
            }
        }
        self.nodes
            .iter()
            .filter(|node| wanted.contains(&node.run.name))
            .collect()
    }

    /// Returns the sources: the nodes that read archives.
    pub fn sources(&self) -> impl Iterator<Item = &NodeLineage> {
        self.nodes.iter().filter(|node| node.is_source())
    }

    /// Returns the keys of all nodes and the digests of all documents: what the closure of the run begins with.
    pub fn roots(&self) -> (Vec<Digest>, Vec<Digest>) {
        let keys = self.nodes.iter().filter_map(|node| node.run.key);
        let documents = self.run.documents.values().map(|document| document.digest);
        (keys.collect(), documents.collect())
    }
}

impl NodeLineage {
    /// Tells whether the node reads an archive.
    pub fn is_source(&self) -> bool {
        self.run.inputs.contains_key(marf_engine::LISTING)
    }

    /// Tells whether the node was asked for by another node.
    pub fn is_child(&self) -> bool {
        self.run.parent.is_some()
    }
}

//! A run as the store has it: nodes with their actions and records, inputs with the outputs that they are, documents.

use std::collections::BTreeSet;
use std::sync::Arc;

use marf_cache::{Action, Digest, Record, Store, read_digest_list};
use marf_engine::{LISTING, NodeRun, NodeState, RunRecord, action_at, run_of, sets};
use marf_stage::{Document, PHOTOS, VERDICTS, Verdict};

use crate::{
    error::RunError,
    product::{SourcePart, parts_of},
};

/// A run and what the store has of its nodes.
pub struct Run<'s> {
    store: &'s Store,
    /// The run root.
    pub record: RunRecord,
    /// The nodes in topological order, the children of a node after it.
    pub nodes: Vec<RunNode>,
}

/// A node of a run and what the store has of its result.
#[derive(Debug, Clone)]
pub struct RunNode {
    /// Its entry in the run root: name, key, edges, inputs, outputs, times.
    pub run: NodeRun,
    /// The earlier run of the result, if the run itself has no result ([`Run::completed`]).
    pub of_run: Option<u64>,
    /// Wall time of the work in the run of the result, in seconds. `None` if that run found the result.
    pub worked_s: Option<f64>,
    /// Everything its result depends on. `None` if the node has no result, or the store has lost the action.
    pub action: Option<Action>,
    /// Its record: outputs, needs, parts, children, device and time. `None` if it is not in the store.
    pub record: Option<Record>,
}

impl<'s> Run<'s> {
    /// Reads a run by its number.
    ///
    /// # Errors
    /// Returns an error if the run or the store cannot be read. Lost objects of a node are not an error.
    pub fn open(store: &'s Store, number: u64) -> Result<Self, RunError> {
        Self::new(store, run_of(store, number)?)
    }

    /// Reads what the store has of a run's nodes.
    ///
    /// # Errors
    /// A store that cannot be read.
    pub fn new(store: &'s Store, record: RunRecord) -> Result<Self, RunError> {
        let node = |run: &NodeRun| -> Result<RunNode, RunError> {
            let action = run.key.map(|key| action_at(store, &key)).transpose()?;
            let record = run.key.map(|key| store.record(&key)).transpose()?;
            Ok(RunNode {
                run: run.clone(),
                of_run: None,
                worked_s: (run.state == NodeState::Finished).then_some(run.seconds),
                action: action.flatten(),
                record: record.flatten(),
            })
        };
        let nodes = record.nodes.iter().map(node).collect::<Result<_, _>>()?;
        Ok(Self { store, record, nodes })
    }

    /// Returns the run with what an earlier run made of the nodes that have no result in it, and of those that it does not have.
    /// What happened to a node in this run, and why, stays.
    #[must_use]
    pub fn completed(mut self, earlier: Self) -> Self {
        let number = Some(earlier.record.number);
        let (children, nodes): (Vec<RunNode>, Vec<RunNode>) =
            earlier.nodes.into_iter().partition(RunNode::is_child);
        let mut taken = BTreeSet::new();
        for mut node in nodes {
            let place = self.nodes.iter().position(|own| own.run.name == node.run.name);
            let own = place.map(|place| &mut self.nodes[place]);
            if own.as_ref().is_some_and(|own| own.run.state.is_good()) {
                continue;
            }
            taken.insert(node.run.name.clone());
            node.of_run = number;
            if let Some(own) = own {
                node.run.state = own.run.state;
                node.run.reason.clone_from(&own.run.reason);
                node.run.cause.clone_from(&own.run.cause);
                node.run.hint.clone_from(&own.run.hint);
                *own = node;
            } else {
                node.run.state = NodeState::Skipped;
                "not part of this run".clone_into(&mut node.run.reason);
                self.nodes.push(node);
            }
        }
        let is_taken = |child: &RunNode| {
            child
                .run
                .parent
                .as_ref()
                .is_some_and(|parent| taken.contains(parent))
        };
        self.nodes.retain(|node| !is_taken(node));
        let children = children.into_iter().filter(is_taken);
        self.nodes.extend(children.map(|child| RunNode {
            of_run: number,
            ..child
        }));
        self
    }

    /// Returns the store.
    pub fn store(&self) -> &'s Store {
        self.store
    }

    /// Reads the bytes of the run root.
    ///
    /// # Errors
    /// A run that is not stored, or not any more.
    pub fn root(&self) -> Result<Vec<u8>, RunError> {
        Ok(self.store.run(self.record.number)?)
    }

    /// Returns a node by its name.
    pub fn node(&self, name: &str) -> Option<&RunNode> {
        self.nodes.iter().find(|node| node.run.name == name)
    }

    /// Returns the nodes that a node has asked for, in topological order.
    pub fn children<'r>(&'r self, parent: &'r str) -> impl Iterator<Item = &'r RunNode> {
        let is_child = move |node: &&RunNode| node.run.parent.as_deref() == Some(parent);
        self.nodes.iter().filter(is_child)
    }

    /// Returns a node, the nodes that made its inputs and their children, and so on up to the sources, in topological
    /// order.
    pub fn upstream(&self, name: &str) -> Vec<&RunNode> {
        let mut wanted = BTreeSet::from([name]);
        // Nodes come after those they read and before their children, so that one way back finds all but the children.
        loop {
            let before = wanted.len();
            for node in &self.nodes {
                let parent = node.run.parent.as_deref();
                if parent.is_some_and(|parent| wanted.contains(parent)) {
                    wanted.insert(&node.run.name);
                }
                if wanted.contains(node.run.name.as_str()) {
                    let inputs = node.run.inputs.values();
                    let makers = inputs.filter_map(|input| input.made_by.as_ref());
                    wanted.extend(makers.map(|made_by| made_by.node.as_str()));
                }
            }
            if wanted.len() == before {
                break;
            }
        }
        let nodes = self.nodes.iter();
        nodes
            .filter(|node| wanted.contains(node.run.name.as_str()))
            .collect()
    }

    /// Returns the sources: the nodes that read archives.
    pub fn sources(&self) -> impl Iterator<Item = &RunNode> {
        self.nodes.iter().filter(|node| node.is_source())
    }

    /// Returns the keys of all nodes.
    pub fn keys(&self) -> Vec<Digest> {
        self.nodes.iter().filter_map(|node| node.run.key).collect()
    }

    /// Returns the digests of all documents. With [`Run::keys`] they lead to everything that belongs to the run.
    pub fn documents(&self) -> Vec<Digest> {
        let documents = self.record.documents.values();
        documents.map(|document| document.digest).collect()
    }

    /// Reads an output of a node.
    ///
    /// # Errors
    /// An output that the node or the store does not have.
    pub fn output(&self, node: &RunNode, name: &str) -> Result<Arc<[u8]>, RunError> {
        Ok(self.store.get(&node.output(name)?)?)
    }

    /// Reads a document that a node has written.
    ///
    /// # Errors
    /// Returns an error if the node or the store lacks the output, or if it is not such a document.
    pub fn document<D: Document>(&self, node: &RunNode) -> Result<D, RunError> {
        D::decode(&self.output(node, D::OUTPUT)?).map_err(|error| RunError::Malformed {
            what: format!("`{}` of `{}`", D::OUTPUT, node.run.name),
            message: error.to_string(),
        })
    }

    /// Reads the verdicts of a node, by sol and id. The list is empty for a node without verdicts.
    ///
    /// # Errors
    /// Returns an error if the store has lost the verdicts, or if the bytes are not verdicts.
    pub fn verdicts(&self, node: &RunNode) -> Result<Vec<Verdict>, RunError> {
        match node.run.outputs.get(VERDICTS) {
            None => Ok(Vec::new()),
            Some(root) => sets::verdicts(&root.digest, |digest| Ok(self.store.get(digest)?)),
        }
    }

    /// Returns the lists of the files that a source read of its archive, sol by sol. The result is empty for
    /// other nodes.
    ///
    /// # Errors
    /// Returns an error if a record or a list of parts is lost, or if the store cannot be read.
    pub fn origins(&self, node: &RunNode) -> Result<Vec<Digest>, RunError> {
        if !node.is_source() {
            return Ok(Vec::new());
        }
        let mut origins = Vec::new();
        for part in node.parts(self.store)? {
            let record = self.store.record(&part.key)?;
            origins.extend(record.and_then(|record| record.origins));
        }
        Ok(origins)
    }

    /// Returns the objects that a node stored next to its outputs, if it makes no set of photos. The rows of a set name their
    /// objects themselves.
    ///
    /// # Errors
    /// Returns an error if a list is lost or damaged.
    pub fn needs(&self, node: &RunNode) -> Result<Vec<Digest>, RunError> {
        let record = node.record.as_ref();
        let list = record.filter(|record| !record.outputs.contains_key(PHOTOS));
        let Some(list) = list.and_then(|record| record.needs) else {
            return Ok(Vec::new());
        };
        read_digest_list(&self.store.get(&list)?).ok_or_else(|| RunError::Malformed {
            what: format!("the list of what `{}` needs", node.run.name),
            message: "it is damaged".to_owned(),
        })
    }
}

impl RunNode {
    /// Returns whether the node reads an archive.
    pub fn is_source(&self) -> bool {
        self.run.inputs.contains_key(LISTING)
    }

    /// Returns whether another node requested this node.
    pub fn is_child(&self) -> bool {
        self.run.parent.is_some()
    }

    /// Returns the parts of a source, by sol.
    ///
    /// # Errors
    /// A record that is lost, or a store that cannot be read.
    pub fn parts(&self, store: &Store) -> Result<Vec<SourcePart>, RunError> {
        let record = self.record.as_ref().ok_or_else(|| RunError::NoRecord {
            what: format!("`{}`", self.run.name),
            key: self.run.key.unwrap_or_else(|| Digest::from_content(&[])),
        })?;
        parts_of(store, record)
    }

    /// Returns the digest of an output that it may not have.
    pub fn digest(&self, output: &str) -> Option<&Digest> {
        self.run.outputs.get(output).map(|output| &output.digest)
    }

    /// Returns the digests of the outputs whose names begin with a prefix, by the rest of their names.
    pub fn outputs_under<'r>(&'r self, prefix: &'r str) -> impl Iterator<Item = (&'r str, &'r Digest)> {
        let outputs = self.run.outputs.iter();
        outputs.filter_map(move |(name, output)| Some((name.strip_prefix(prefix)?, &output.digest)))
    }

    /// Returns the names of the nodes that it reads.
    pub fn upstream(&self) -> impl Iterator<Item = &str> {
        self.run.edges.iter().map(|edge| edge.upstream.as_str())
    }

    /// Returns the digest of an output.
    ///
    /// # Errors
    /// An output that the node does not have.
    pub fn output(&self, name: &str) -> Result<Digest, RunError> {
        let output = self.run.outputs.get(name);
        let output = output.ok_or_else(|| RunError::Malformed {
            what: format!("`{}`", self.run.name),
            message: format!("it has no output `{name}`"),
        })?;
        Ok(output.digest)
    }

    /// Returns program and device that made the result, as text, or `None` if the record is lost.
    pub fn made_by(&self) -> Option<String> {
        let made = &self.record.as_ref()?.metadata;
        Some(format!("{} on {}", made.program, made.device))
    }
}

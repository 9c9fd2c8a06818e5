//! A node during a run.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Instant,
};

use marf_cache::{Digest, Output};
use marf_stage::{Inputs, Outputs, Stage, StageDef};

use crate::{
    check::{Connection, Edge},
    graph::Node,
    key::Key,
    listing::SourceListing,
    work::Counts,
};

/// A node during a run: its stage, its state and its outcome.
pub(super) struct Task {
    pub(super) name: String,
    pub(super) def: StageDef,
    pub(super) bound: Arc<dyn Stage>,
    pub(super) edges: Vec<Edge>,
    pub(super) inputs: InputSource,
    pub(super) parent: Option<usize>,
    /// In the order of the requests, round after round.
    pub(super) children: Vec<usize>,
    pub(super) role: Role,
    pub(super) phase: Phase,
    /// Nodes that must settle first.
    pub(super) waits_for: BTreeSet<usize>,
    pub(super) reuse: Reuse,
    /// Blobs that were lost when it ran, with how often.
    pub(super) lost: BTreeMap<Digest, u32>,
    pub(super) prepared: Option<RunInputs>,
    pub(super) began: Option<Instant>,
    pub(super) outcome: NodeOutcome,
}

/// Where inputs come from.
pub(super) enum InputSource {
    /// From upstream nodes of the graph.
    Upstream(Vec<Connection>),
    /// Given by the parent of a child.
    Fixed(Inputs),
}

/// The role of a node in a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// It is selected: it may run.
    Run,
    /// It is not selected, but its stored result is needed.
    LookUp,
    /// It is not needed.
    Ignore,
}

/// Whether a stored result of the node may be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reuse {
    /// The result is used.
    Allowed,
    /// A blob of the result was lost: the node runs again.
    Forbidden,
}

/// How far a node is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    /// Upstream nodes have not settled.
    Waiting,
    /// It has inputs and a key that is not in the store.
    Ready,
    Running,
    /// Its children are running.
    Expanding,
    /// Its children so far have their outputs: it asks for further ones or reduces them.
    Reducible,
    /// It has a stored result.
    Reused,
    /// It ran and has a result.
    Finished,
    Failed,
    /// An upstream node has no result.
    Skipped,
    /// The run was stopped first.
    Stopped,
    /// It is not selected and has no stored result.
    Absent,
    /// A child of an expansion that starts over.
    Replaced,
}

/// The data that a node needs to run.
#[derive(Clone)]
pub(super) struct RunInputs {
    pub(super) key: Key,
    pub(super) inputs: Inputs,
    pub(super) listed: Option<SourceListing>,
    pub(super) reason: String,
}

/// The entry of the node in the run record.
#[derive(Default)]
pub(super) struct NodeOutcome {
    pub(super) key: Option<Digest>,
    pub(super) reason: String,
    pub(super) cause: Option<String>,
    pub(super) hint: Option<String>,
    pub(super) seconds: f64,
    pub(super) started_unix_s: Option<u64>,
    pub(super) outputs: BTreeMap<String, Output>,
    pub(super) counts: Counts,
    /// Keys of the children of a reused node.
    pub(super) stored_children: BTreeMap<String, Digest>,
}

impl NodeOutcome {
    /// Returns the reason and its cause in one line.
    pub(super) fn why(&self) -> String {
        let cause = self.cause.iter().map(|cause| format!(": {cause}"));
        std::iter::once(self.reason.clone()).chain(cause).collect()
    }
}

impl Task {
    /// Returns the task of a node of the graph.
    pub(super) fn of_node(node: &Node, role: Role) -> Self {
        let phase = match role {
            Role::Ignore => Phase::Absent,
            Role::Run | Role::LookUp => Phase::Waiting,
        };
        Self {
            edges: node.edges.clone(),
            role,
            phase,
            waits_for: node
                .connections
                .iter()
                .map(|connection| connection.upstream)
                .collect(),
            ..Self::new(
                node.name.clone(),
                node.def,
                Arc::clone(&node.bound),
                InputSource::Upstream(node.connections.clone()),
            )
        }
    }

    /// Returns a task that waits for nothing.
    pub(super) fn new(name: String, def: StageDef, bound: Arc<dyn Stage>, inputs: InputSource) -> Self {
        Self {
            name,
            def,
            bound,
            edges: Vec::new(),
            inputs,
            parent: None,
            children: Vec::new(),
            role: Role::Run,
            phase: Phase::Waiting,
            waits_for: BTreeSet::new(),
            reuse: Reuse::Allowed,
            lost: BTreeMap::new(),
            prepared: None,
            began: None,
            outcome: NodeOutcome::default(),
        }
    }

    /// Returns the digests of its outputs by name.
    pub(super) fn outputs(&self) -> Outputs {
        let outputs = self.outcome.outputs.iter();
        outputs
            .map(|(name, output)| (name.clone(), output.digest))
            .collect()
    }
}

impl Phase {
    /// Returns whether it has its outputs.
    pub(super) fn is_good(self) -> bool {
        matches!(self, Self::Reused | Self::Finished)
    }

    /// Returns whether its state is final.
    pub(super) fn is_settled(self) -> bool {
        !matches!(
            self,
            Self::Waiting | Self::Ready | Self::Running | Self::Expanding | Self::Reducible
        )
    }
}

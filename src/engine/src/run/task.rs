//! A node while its graph runs.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Instant,
};

use marf_cache::{Digest, Output};
use marf_stage::{Inputs, Listing, Outputs, Stage, StageDef};

use crate::{Edge, graph::Node, graph::Wire, key::Key, work::Counts};

pub(super) struct Task {
    pub(super) name: String,
    pub(super) def: StageDef,
    pub(super) bound: Arc<dyn Stage>,
    pub(super) edges: Vec<Edge>,
    pub(super) feed: Feed,
    pub(super) parent: Option<usize>,
    /// In the order they were asked for.
    pub(super) children: Vec<usize>,
    pub(super) role: Role,
    pub(super) phase: Phase,
    pub(super) waits: BTreeSet<usize>,
    pub(super) trust: Trust,
    pub(super) tries: u32,
    pub(super) order: Option<Order>,
    pub(super) began: Option<Instant>,
    pub(super) told: Told,
}

/// Where inputs come from.
pub(super) enum Feed {
    /// From nodes of the graph.
    Wires(Vec<Wire>),
    /// Given by the node that asked for this one.
    Fixed(Inputs),
}

/// What a run may do with a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Run,
    /// It was not chosen, but its stored result is needed.
    LookUp,
    Leave,
}

/// Whether a stored result of the node is believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trust {
    Stored,
    /// A blob behind it was lost: it runs again.
    Nothing,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    Waiting,
    Ready,
    Running,
    /// Its children are on their way.
    Expanding,
    /// Its children have their outputs.
    Reducible,
    Reused,
    Finished,
    Failed,
    Skipped,
    Stopped,
    /// It was not chosen and has no stored result.
    Absent,
    /// A child of an expansion that is done anew.
    Replaced,
}

/// All that is needed to do a node's work.
#[derive(Clone)]
pub(super) struct Order {
    pub(super) key: Key,
    pub(super) inputs: Inputs,
    pub(super) listing: Option<Listing>,
    pub(super) reason: String,
}

/// What the run record will tell of the node.
#[derive(Default)]
pub(super) struct Told {
    pub(super) key: Option<Digest>,
    pub(super) reason: String,
    pub(super) seconds: f64,
    pub(super) outputs: BTreeMap<String, Output>,
    pub(super) counts: Counts,
    /// Keys of children that did not have to be asked for.
    pub(super) children: BTreeMap<String, Digest>,
}

impl Task {
    pub(super) fn of_node(node: &Node, role: Role) -> Self {
        let phase = match role {
            Role::Leave => Phase::Absent,
            Role::Run | Role::LookUp => Phase::Waiting,
        };
        Self {
            edges: node.edges.clone(),
            role,
            phase,
            waits: node.wires.iter().map(|wire| wire.upstream).collect(),
            ..Self::new(
                node.name.clone(),
                node.def,
                Arc::clone(&node.bound),
                Feed::Wires(node.wires.clone()),
            )
        }
    }

    pub(super) fn new(name: String, def: StageDef, bound: Arc<dyn Stage>, feed: Feed) -> Self {
        Self {
            name,
            def,
            bound,
            edges: Vec::new(),
            feed,
            parent: None,
            children: Vec::new(),
            role: Role::Run,
            phase: Phase::Waiting,
            waits: BTreeSet::new(),
            trust: Trust::Stored,
            tries: 0,
            order: None,
            began: None,
            told: Told::default(),
        }
    }

    pub(super) fn outputs(&self) -> Outputs {
        let outputs = self.told.outputs.iter();
        outputs
            .map(|(name, output)| (name.clone(), output.digest))
            .collect()
    }
}

impl Phase {
    /// Its outputs are there.
    pub(super) fn is_good(self) -> bool {
        matches!(self, Self::Reused | Self::Finished)
    }

    /// Nothing more happens to it.
    pub(super) fn is_settled(self) -> bool {
        !matches!(
            self,
            Self::Waiting | Self::Ready | Self::Running | Self::Expanding | Self::Reducible
        )
    }
}

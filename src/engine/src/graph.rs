//! The graph of a pipeline: nodes as declared, checked once, in topological order.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use marf_cache::{Bytes, ContentHash, ContentHasher, Digest, canonical_json, digest_of};
use marf_stage::{Stage, StageDef, StageError};

use crate::check::{Connection, Edge, GraphError, NodeShape, Topology, topology};
use crate::listing::{Listings, SourceListing};

/// A node as declared: a stage with its parameters, and the upstream nodes of its inputs.
pub struct NodeDecl {
    /// Name of the node, unique in its graph.
    pub name: String,
    /// The stage's row in the table.
    pub stage: StageDef,
    /// The stage with its parameters.
    pub bound: Box<dyn Stage>,
    /// The upstream node of each key.
    pub edges: Vec<Edge>,
}

/// A checked graph: names are unique, every input has an upstream output, and there is no cycle.
pub struct Graph {
    /// In topological order, ties in the order declared.
    pub(crate) nodes: Vec<Node>,
    /// Stages by name, for the children of expanding nodes.
    pub(crate) table: BTreeMap<&'static str, StageDef>,
    /// The listings of its sources, if it shares them with other graphs. Otherwise each plan and each run asks the sources.
    listings: Option<Listings>,
    digest: Digest,
}

/// A checked node.
pub(crate) struct Node {
    pub(crate) name: String,
    pub(crate) def: StageDef,
    pub(crate) bound: Arc<dyn Stage>,
    pub(crate) edges: Vec<Edge>,
    pub(crate) connections: Vec<Connection>,
}

/// A view of a node of a graph.
#[derive(Debug, Clone, Copy)]
pub struct NodeView<'a> {
    /// Its name.
    pub name: &'a str,
    /// Name of its stage.
    pub stage: &'static str,
    /// The upstream node for each of its keys.
    pub edges: &'a [Edge],
    /// Names of its outputs.
    pub outputs: &'static [&'static str],
}

impl NodeDecl {
    fn shape(&self) -> NodeShape<'_> {
        NodeShape {
            name: &self.name,
            stage: &self.stage,
            edges: &self.edges,
        }
    }
}

impl Graph {
    /// Checks and sorts a graph. `table` holds every stage that a child may use.
    ///
    /// # Errors
    /// The first fault: of names, of edges, of outputs, of the order.
    pub fn new(decls: Vec<NodeDecl>, table: &[StageDef]) -> Result<Self, GraphError> {
        let shapes: Vec<NodeShape<'_>> = decls.iter().map(NodeDecl::shape).collect();
        let Topology { order, connections } = topology(&shapes)?;
        let mut position = vec![0; order.len()];
        for (at, &index) in order.iter().enumerate() {
            position[index] = at;
        }
        let mut decls: Vec<Option<NodeDecl>> = decls.into_iter().map(Some).collect();
        let mut graph = Self {
            nodes: Vec::new(),
            table: table.iter().map(|def| (def.name, *def)).collect(),
            listings: None,
            digest: Digest::from_content(&[]),
        };
        for index in order {
            let Some(decl) = decls[index].take() else { continue };
            let connections = connections[index].iter().map(|connection| Connection {
                upstream: position[connection.upstream],
                ..connection.clone()
            });
            graph.nodes.push(Node {
                name: decl.name,
                def: decl.stage,
                bound: Arc::from(decl.bound),
                edges: decl.edges,
                connections: connections.collect(),
            });
        }
        graph.digest = digest_of(&graph.nodes);
        Ok(graph)
    }

    /// Returns the graph with listings that it shares with others of the same pipeline.
    #[must_use]
    pub fn sharing(self, listings: &Listings) -> Self {
        Self {
            listings: Some(listings.clone()),
            ..self
        }
    }

    /// Returns the known listing of a source, or else asks the source.
    pub(crate) fn listed(
        &self,
        node: &str,
        ask: impl FnOnce() -> Result<Option<SourceListing>, StageError>,
    ) -> Result<Option<SourceListing>, StageError> {
        match &self.listings {
            Some(listings) => listings.get_or_ask(node, ask),
            None => ask(),
        }
    }

    /// Keeps the listing of a source that a fetch has found.
    pub(crate) fn keep_listed(&self, node: &str, listed: &SourceListing) {
        if let Some(listings) = &self.listings {
            listings.keep(node, listed);
        }
    }

    /// Returns the names of the nodes: topological, ties in the order declared.
    pub fn names(&self) -> Vec<&str> {
        self.nodes.iter().map(|node| node.name.as_str()).collect()
    }

    /// Returns the nodes, in the order of [`Graph::names`].
    pub fn nodes(&self) -> impl Iterator<Item = NodeView<'_>> {
        self.nodes.iter().map(|node| NodeView {
            name: &node.name,
            stage: node.def.name,
            edges: &node.edges,
            outputs: node.def.outputs,
        })
    }

    /// Returns the backends of the nodes that do not run on the CPU. Asks for a GPU only if a node wants one.
    pub fn backends(&self) -> BTreeSet<String> {
        self.nodes
            .iter()
            .filter_map(|node| node.bound.backend_id())
            .collect()
    }

    /// Returns the digest of the pipeline as declared: names, stages, versions, parameters, edges.
    pub fn digest(&self) -> Digest {
        self.digest
    }

    /// Returns the index of a node by name.
    pub(crate) fn index(&self, name: &str) -> Option<usize> {
        self.nodes.iter().position(|node| node.name == name)
    }

    /// Returns the nodes themselves and all they depend on.
    pub(crate) fn with_ancestors(&self, nodes: &BTreeSet<usize>) -> BTreeSet<usize> {
        let mut found = nodes.clone();
        for index in (0..self.nodes.len()).rev() {
            if found.contains(&index) {
                found.extend(
                    self.nodes[index]
                        .connections
                        .iter()
                        .map(|connection| connection.upstream),
                );
            }
        }
        found
    }

    /// Returns the nodes themselves and all that depend on them.
    pub(crate) fn with_descendants(&self, nodes: &BTreeSet<usize>) -> BTreeSet<usize> {
        let mut found = nodes.clone();
        for (index, node) in self.nodes.iter().enumerate() {
            if node
                .connections
                .iter()
                .any(|connection| found.contains(&connection.upstream))
            {
                found.insert(index);
            }
        }
        found
    }
}

impl ContentHash for Node {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        let params = canonical_json(&self.bound.params());
        let fields: [(&str, &dyn ContentHash); 5] = [
            ("name", &self.name),
            ("stage", &self.def.name),
            ("version", &self.def.version),
            ("params", &Bytes(&params)),
            ("edges", &self.edges),
        ];
        hasher.record("node", &fields);
    }
}

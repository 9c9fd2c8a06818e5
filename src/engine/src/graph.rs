//! The static graph: nodes as declared, checked once, in topological order.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use marf_cache::{ContentHash, Digest, digest_of};
use marf_stage::{Port, Stage, StageDef};
use petgraph::{Direction, algo::tarjan_scc, graph::DiGraph, graph::NodeIndex};
use serde::{Deserialize, Serialize};

/// A node as declared: a stage with its parameters, and where its inputs come from.
pub struct NodeDecl {
    /// Name of the node, unique in its graph.
    pub name: String,
    /// The stage's row in the table.
    pub stage: StageDef,
    /// The stage with its parameters.
    pub bound: Box<dyn Stage>,
    /// Which node each key names.
    pub edges: Vec<Edge>,
}

/// "This key names that node."
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ContentHash)]
pub struct Edge {
    /// The key in the node's table (`input`).
    pub key: String,
    /// The node it names.
    pub upstream: String,
}

/// A graph without faults: names are unique, every input has a source, nothing runs in circles.
pub struct Graph {
    /// In topological order, ties in the order declared.
    pub(crate) nodes: Vec<Node>,
    pub(crate) table: BTreeMap<&'static str, StageDef>,
    digest: Digest,
}

pub(crate) struct Node {
    pub(crate) name: String,
    pub(crate) def: StageDef,
    pub(crate) bound: Arc<dyn Stage>,
    pub(crate) edges: Vec<Edge>,
    pub(crate) wires: Vec<Wire>,
}

/// One output of an upstream node that flows into a node, under the output's name.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wire {
    pub(crate) output: &'static str,
    /// Index of the upstream node.
    pub(crate) upstream: usize,
}

/// A node of a graph, to look at.
#[derive(Debug, Clone, Copy)]
pub struct NodeView<'a> {
    /// Its name.
    pub name: &'a str,
    /// Name of its stage.
    pub stage: &'static str,
    /// Which node each of its keys names.
    pub edges: &'a [Edge],
    /// Names of its outputs.
    pub outputs: &'static [&'static str],
}

/// What is wrong with a graph.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GraphError {
    /// Two nodes of one name.
    #[error("two nodes are named `{node}`")]
    DuplicateNode {
        /// The name.
        node: String,
    },
    /// A key names a node that is not there.
    #[error("`{node}.{key}` names the node `{upstream}`, which is not there; there are {}", known.join(", "))]
    UnknownUpstream {
        /// The node with the key.
        node: String,
        /// The key.
        key: String,
        /// The name that is not there.
        upstream: String,
        /// The names that are.
        known: Vec<String>,
    },
    /// A key that the stage does not have.
    #[error("`{node}` has no input `{key}`; it has {}", known.join(", "))]
    UnknownKey {
        /// The node.
        node: String,
        /// The key it does not have.
        key: String,
        /// The keys it has.
        known: Vec<String>,
    },
    /// An input the stage cannot run without.
    #[error("`{node}` needs `{key}`, the name of a node that gives `{output}`")]
    NotConnected {
        /// The node.
        node: String,
        /// The key that is absent.
        key: String,
        /// The output it would bring.
        output: String,
    },
    /// The upstream node does not give what is wanted of it.
    #[error("`{node}.{key}` wants `{output}` of `{upstream}`, which gives {}", outputs.join(", "))]
    NoSuchOutput {
        /// The node.
        node: String,
        /// The key.
        key: String,
        /// The upstream node.
        upstream: String,
        /// The output it does not give.
        output: String,
        /// The outputs it gives.
        outputs: Vec<String>,
    },
    /// Two sources for one input.
    #[error("`{node}` gets `{input}` twice")]
    Ambiguous {
        /// The node.
        node: String,
        /// The key or input that is there twice.
        input: String,
    },
    /// Nodes that wait for each other.
    #[error("nodes wait for each other: {}", path.join(" -> "))]
    Cycle {
        /// Along the flow of data, the first node once more at the end.
        path: Vec<String>,
    },
}

impl Graph {
    /// Checks and sorts a graph. `table` holds every stage that an expanding stage may ask for.
    ///
    /// # Errors
    /// The first fault, in the order of [`GraphError`].
    pub fn new(decls: Vec<NodeDecl>, table: &[StageDef]) -> Result<Self, GraphError> {
        let names = names_of(&decls)?;
        check_edges(&decls, &names)?;
        let order = topological(&decls, &names)?;
        let mut decls: Vec<Option<NodeDecl>> = decls.into_iter().map(Some).collect();
        let mut graph = Self {
            nodes: Vec::new(),
            table: table.iter().map(|def| (def.name, *def)).collect(),
            digest: Digest::of(&[]),
        };
        for decl in order.into_iter().filter_map(|index| decls[index].take()) {
            let wires = graph.wires(&decl)?;
            graph.nodes.push(Node {
                name: decl.name,
                def: decl.stage,
                bound: Arc::from(decl.bound),
                edges: decl.edges,
                wires,
            });
        }
        graph.digest = digest_of(&graph.nodes);
        Ok(graph)
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

    /// Returns the digest of the pipeline as declared: names, stages, versions, parameters, edges.
    pub fn digest(&self) -> Digest {
        self.digest
    }

    pub(crate) fn index(&self, name: &str) -> Option<usize> {
        self.nodes.iter().position(|node| node.name == name)
    }

    /// Upstream nodes are here already, as nodes come in topological order.
    fn wires(&self, decl: &NodeDecl) -> Result<Vec<Wire>, GraphError> {
        let mut wires: Vec<Wire> = Vec::new();
        for edge in &decl.edges {
            let Some(upstream) = self.index(&edge.upstream) else {
                continue;
            };
            let found = self.wires_of(decl, edge, upstream)?;
            if let Some(twice) = found
                .iter()
                .find(|new| wires.iter().any(|old| old.output == new.output))
            {
                return Err(GraphError::Ambiguous {
                    node: decl.name.clone(),
                    input: twice.output.to_owned(),
                });
            }
            wires.extend(found);
        }
        Ok(wires)
    }

    /// An optional port may find nothing, but then another port of its key must find something.
    fn wires_of(&self, decl: &NodeDecl, edge: &Edge, upstream: usize) -> Result<Vec<Wire>, GraphError> {
        let given = self.nodes[upstream].def.outputs;
        let ports = decl.stage.ports.iter().filter(|port| port.key == edge.key);
        let (found, absent): (Vec<&Port>, Vec<&Port>) = ports.partition(|port| given.contains(&port.output));
        let fault = match found.is_empty() {
            true => absent.first(),
            false => absent.iter().find(|port| port.required),
        };
        if let Some(port) = fault {
            return Err(GraphError::NoSuchOutput {
                node: decl.name.clone(),
                key: edge.key.clone(),
                upstream: edge.upstream.clone(),
                output: port.output.to_owned(),
                outputs: given.iter().map(|&output| output.to_owned()).collect(),
            });
        }
        let wires = found.into_iter().map(|port| Wire {
            output: port.output,
            upstream,
        });
        Ok(wires.collect())
    }

    /// Returns the nodes themselves and all they depend on.
    pub(crate) fn with_ancestors(&self, of: &BTreeSet<usize>) -> BTreeSet<usize> {
        let mut found = of.clone();
        for index in (0..self.nodes.len()).rev() {
            if found.contains(&index) {
                found.extend(self.nodes[index].wires.iter().map(|wire| wire.upstream));
            }
        }
        found
    }

    /// Returns the nodes themselves and all that depend on them.
    pub(crate) fn with_descendants(&self, of: &BTreeSet<usize>) -> BTreeSet<usize> {
        let mut found = of.clone();
        for (index, node) in self.nodes.iter().enumerate() {
            if node.wires.iter().any(|wire| found.contains(&wire.upstream)) {
                found.insert(index);
            }
        }
        found
    }
}

impl ContentHash for Node {
    fn walk(&self, visitor: &mut dyn marf_cache::Visitor) {
        visitor.open("node", 5);
        visitor.field("name");
        self.name.walk(visitor);
        visitor.field("stage");
        self.def.name.walk(visitor);
        visitor.field("version");
        self.def.version.walk(visitor);
        visitor.field("params");
        self.bound.params().walk(visitor);
        visitor.field("edges");
        self.edges.walk(visitor);
        visitor.close();
    }
}

fn names_of(decls: &[NodeDecl]) -> Result<BTreeMap<&str, usize>, GraphError> {
    let mut names = BTreeMap::new();
    for (index, decl) in decls.iter().enumerate() {
        if names.insert(decl.name.as_str(), index).is_some() {
            return Err(GraphError::DuplicateNode {
                node: decl.name.clone(),
            });
        }
    }
    Ok(names)
}

fn check_edges(decls: &[NodeDecl], names: &BTreeMap<&str, usize>) -> Result<(), GraphError> {
    for decl in decls {
        for edge in &decl.edges {
            check_edge(decl, edge, names)?;
        }
        let connected = |key| decl.edges.iter().any(|edge| edge.key == key);
        let mut required = decl.stage.ports.iter().filter(|port| port.required);
        if let Some(port) = required.find(|port| !connected(port.key)) {
            return Err(GraphError::NotConnected {
                node: decl.name.clone(),
                key: port.key.to_owned(),
                output: port.output.to_owned(),
            });
        }
    }
    Ok(())
}

fn check_edge(decl: &NodeDecl, edge: &Edge, names: &BTreeMap<&str, usize>) -> Result<(), GraphError> {
    let keys: BTreeSet<&str> = decl.stage.ports.iter().map(|port| port.key).collect();
    if !keys.contains(edge.key.as_str()) {
        return Err(GraphError::UnknownKey {
            node: decl.name.clone(),
            key: edge.key.clone(),
            known: keys.into_iter().map(str::to_owned).collect(),
        });
    }
    if decl.edges.iter().filter(|other| other.key == edge.key).count() > 1 {
        return Err(GraphError::Ambiguous {
            node: decl.name.clone(),
            input: edge.key.clone(),
        });
    }
    if !names.contains_key(edge.upstream.as_str()) {
        return Err(GraphError::UnknownUpstream {
            node: decl.name.clone(),
            key: edge.key.clone(),
            upstream: edge.upstream.clone(),
            known: names.keys().map(|&name| name.to_owned()).collect(),
        });
    }
    Ok(())
}

type Flow = DiGraph<usize, ()>;

fn topological(decls: &[NodeDecl], names: &BTreeMap<&str, usize>) -> Result<Vec<usize>, GraphError> {
    let mut flow = Flow::new();
    let nodes: Vec<NodeIndex> = (0..decls.len()).map(|index| flow.add_node(index)).collect();
    for (index, decl) in decls.iter().enumerate() {
        for upstream in decl
            .edges
            .iter()
            .filter_map(|edge| names.get(edge.upstream.as_str()))
        {
            flow.update_edge(nodes[*upstream], nodes[index], ());
        }
    }
    if let Some(path) = cycle(&flow) {
        let path = path.into_iter().map(|node| decls[flow[node]].name.clone());
        return Err(GraphError::Cycle { path: path.collect() });
    }
    Ok(in_order(&flow))
}

/// Takes the first declared of the nodes that wait for nothing, again and again.
fn in_order(flow: &Flow) -> Vec<usize> {
    let waits = |node| flow.neighbors_directed(node, Direction::Incoming).count();
    let mut left: Vec<usize> = flow.node_indices().map(waits).collect();
    let mut ready: BTreeSet<NodeIndex> = flow
        .node_indices()
        .filter(|node| left[node.index()] == 0)
        .collect();
    let mut order = Vec::new();
    while let Some(node) = ready.pop_first() {
        order.push(flow[node]);
        for next in flow.neighbors(node) {
            left[next.index()] -= 1;
            if left[next.index()] == 0 {
                ready.insert(next);
            }
        }
    }
    order
}

/// Returns a shortest circle through the first node that is in one.
fn cycle(flow: &Flow) -> Option<Vec<NodeIndex>> {
    let circles = tarjan_scc(flow).into_iter();
    let start = circles
        .filter(|part| part.len() > 1 || flow.contains_edge(part[0], part[0]))
        .filter_map(|part| part.into_iter().min())
        .min()?;
    let mut came_from: BTreeMap<NodeIndex, NodeIndex> = BTreeMap::new();
    let mut wave = vec![start];
    while !came_from.contains_key(&start) && !wave.is_empty() {
        let mut next_wave = Vec::new();
        for node in wave {
            let mut next: Vec<NodeIndex> = flow.neighbors(node).collect();
            next.sort_unstable();
            next.retain(|next| !came_from.contains_key(next));
            came_from.extend(next.iter().map(|next| (*next, node)));
            next_wave.extend(next);
        }
        wave = next_wave;
    }
    let mut path = vec![start];
    let mut at = *came_from.get(&start)?;
    while at != start {
        path.push(at);
        at = *came_from.get(&at)?;
    }
    path.push(start);
    path.reverse();
    Some(path)
}

//! The checks of a graph: names, edges, outputs, cycles.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{ContentHash, ContentHasher};
use marf_stage::{Port, StageDef};
use petgraph::{Direction, algo::tarjan_scc, graph::DiGraph, graph::NodeIndex};
use serde::{Deserialize, Serialize};

/// An edge of the graph: a key of a node, and the upstream node that it names.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Edge {
    /// The key in the node's table (`input`).
    pub key: String,
    /// The upstream node.
    pub upstream: String,
    /// The part that is read, of an output of several parts (`photos/a` for the output `photos`). None for the whole output.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<String>,
}

impl ContentHash for Edge {
    fn hash_content(&self, hasher: &mut ContentHasher) {
        let fields: [(&str, &dyn ContentHash); 3] = [
            ("key", &self.key),
            ("upstream", &self.upstream),
            ("part", &self.part),
        ];
        hasher.record("Edge", &fields);
    }
}

impl Edge {
    /// Returns the edge that a pipeline writes as `key = "upstream"` or `key = "upstream/part"`.
    pub fn new(key: impl Into<String>, named: &str) -> Self {
        let (upstream, part) = match named.split_once('/') {
            Some((upstream, part)) => (upstream, Some(part.to_owned())),
            None => (named, None),
        };
        Self {
            key: key.into(),
            upstream: upstream.to_owned(),
            part,
        }
    }

    /// Returns the name under which the upstream node has what is read as an output.
    pub fn source<'o>(&self, output: &'o str) -> Cow<'o, str> {
        part_of(output, self.part.as_deref())
    }
}

fn part_of<'o>(output: &'o str, part: Option<&str>) -> Cow<'o, str> {
    match part {
        None => Cow::Borrowed(output),
        Some(part) => Cow::Owned(format!("{output}/{part}")),
    }
}

/// The part of a node that decides whether it fits into a graph.
#[derive(Clone)]
pub struct NodeShape<'a> {
    /// Name of the node.
    pub name: &'a str,
    /// Its stage.
    pub stage: &'a StageDef,
    /// Its keys, each with the upstream node that it names.
    pub edges: &'a [Edge],
}

/// An output of an upstream node, or a part of it, that is an input of a node.
#[derive(Debug, Clone)]
pub(crate) struct Connection {
    /// The name under which the node reads it.
    pub(crate) input: Cow<'static, str>,
    pub(crate) output: &'static str,
    /// The part of it, if it is not read whole.
    pub(crate) part: Option<String>,
    /// Index of the upstream node.
    pub(crate) upstream: usize,
}

impl Connection {
    /// Returns the name under which the upstream node has it.
    pub(crate) fn source(&self) -> Cow<'static, str> {
        part_of(self.output, self.part.as_deref())
    }
}

/// The order and the connections of checked nodes.
pub(crate) struct Topology {
    /// Indices of the nodes in topological order, ties in the order given.
    pub(crate) order: Vec<usize>,
    /// The connections of each node, in the order given.
    pub(crate) connections: Vec<Vec<Connection>>,
}

/// Why nodes do not form a graph.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct GraphError {
    /// What is wrong.
    pub message: String,
    /// The node at fault. For a cycle, this is the first one.
    pub node: String,
    /// The key at fault, if the fault is that of one key of the node.
    pub key: Option<String>,
    /// A hint for the user, if the input at fault has one.
    pub hint: Option<&'static str>,
    /// The output that an upstream node should give. An output of several parts ends with `/`.
    pub lacks: Option<String>,
}

impl GraphError {
    fn new(node: &str, message: String) -> Self {
        Self {
            message,
            node: node.to_owned(),
            key: None,
            hint: None,
            lacks: None,
        }
    }

    fn at_key(node: &str, key: &str, message: String) -> Self {
        Self {
            key: Some(key.to_owned()),
            ..Self::new(node, message)
        }
    }

    /// Two upstream nodes for one input.
    fn ambiguous(node: &str, input: &str) -> Self {
        Self::new(node, format!("`{node}` gets `{input}` twice"))
    }
}

/// Checks that nodes form a graph.
///
/// # Errors
/// The first fault: of names, of edges, of outputs, of the order.
pub fn check(nodes: &[NodeShape<'_>]) -> Result<(), GraphError> {
    topology(nodes).map(drop)
}

/// Checks nodes, and returns their order and connections.
pub(crate) fn topology(nodes: &[NodeShape<'_>]) -> Result<Topology, GraphError> {
    let names = index_by_name(nodes)?;
    nodes.iter().try_for_each(|node| check_edges(node, &names))?;
    let connections: Result<Vec<_>, _> = nodes
        .iter()
        .map(|node| connections(node, nodes, &names))
        .collect();
    Ok(Topology {
        connections: connections?,
        order: topological_order(nodes, &names)?,
    })
}

fn index_by_name<'a>(nodes: &[NodeShape<'a>]) -> Result<BTreeMap<&'a str, usize>, GraphError> {
    let mut names = BTreeMap::new();
    for (index, node) in nodes.iter().enumerate() {
        if names.insert(node.name, index).is_some() {
            let message = format!("two nodes are named `{}`", node.name);
            return Err(GraphError::new(node.name, message));
        }
    }
    Ok(names)
}

/// Checks that every edge has a known key and a known upstream node, and that every required key has an edge.
fn check_edges(node: &NodeShape<'_>, names: &BTreeMap<&str, usize>) -> Result<(), GraphError> {
    for edge in node.edges {
        check_edge(node, edge, names)?;
    }
    let is_connected = |port: &Port| node.edges.iter().any(|edge| edge.key == port.key);
    let mut required = node.stage.ports.iter().filter(|port| port.required);
    match required.find(|port| !is_connected(port)) {
        None => Ok(()),
        Some(port) => {
            let (name, key, output) = (node.name, port.key, port.output);
            let message = format!("`{name}` needs `{key}`, the name of a node that gives `{output}`");
            Err(GraphError::new(name, message))
        }
    }
}

fn check_edge(
    node: &NodeShape<'_>,
    Edge { key, upstream, .. }: &Edge,
    names: &BTreeMap<&str, usize>,
) -> Result<(), GraphError> {
    let name = node.name;
    let keys: BTreeSet<&str> = node.stage.ports.iter().map(|port| port.key).collect();
    if !keys.contains(key.as_str()) {
        let known: Vec<&str> = keys.into_iter().collect();
        let message = format!(
            "`{name}` has no input `{key}`. Its inputs are {}",
            known.join(", ")
        );
        return Err(GraphError::at_key(name, key, message));
    }
    let takes_many = node.stage.ports.iter().any(|port| port.key == key && port.many);
    let same = |other: &&Edge| other.key == *key && (!takes_many || other.upstream == *upstream);
    if node.edges.iter().filter(same).count() > 1 {
        return Err(GraphError::ambiguous(name, key));
    }
    if !names.contains_key(upstream.as_str()) {
        let known: Vec<&str> = names.keys().copied().collect();
        let message = format!(
            "`{name}.{key}` names the node `{upstream}`, which does not exist. The nodes are {}",
            known.join(", ")
        );
        return Err(GraphError::at_key(name, key, message));
    }
    Ok(())
}

/// Returns the connections of a node. No two may be the same input.
fn connections(
    node: &NodeShape<'_>,
    nodes: &[NodeShape<'_>],
    names: &BTreeMap<&str, usize>,
) -> Result<Vec<Connection>, GraphError> {
    let mut connections: Vec<Connection> = Vec::new();
    for edge in node.edges {
        let Some(&index) = names.get(edge.upstream.as_str()) else {
            continue;
        };
        for port in connected_ports(node, edge, &nodes[index])? {
            let input = port.input(&edge.upstream);
            if connections.iter().any(|other| other.input == input) {
                return Err(GraphError::ambiguous(node.name, &input));
            }
            connections.push(Connection {
                input,
                output: port.output,
                part: edge.part.clone(),
                upstream: index,
            });
        }
    }
    Ok(connections)
}

/// Returns the ports of a key whose output the upstream node has: all required ones, and at least one.
fn connected_ports<'a>(
    node: &NodeShape<'a>,
    edge: &Edge,
    upstream: &NodeShape<'_>,
) -> Result<Vec<&'a Port>, GraphError> {
    let outputs = upstream.stage.outputs;
    let ports = node.stage.ports.iter().filter(|port| port.key == edge.key);
    let wanted = |port: &Port| match edge.part {
        None => port.output.to_owned(),
        Some(_) => format!("{}/", port.output),
    };
    let (found, absent): (Vec<&Port>, Vec<&Port>) =
        ports.partition(|port| outputs.contains(&wanted(port).as_str()));
    let fault = if found.is_empty() {
        absent.first()
    } else {
        absent.iter().find(|port| port.required)
    };
    match fault {
        None => Ok(found),
        Some(port) => {
            let output = wanted(port);
            let message = format!(
                "`{}` of `node.{}` needs `{output}`, but `node.{}` (stage `{}`) gives {}",
                edge.key,
                node.name,
                upstream.name,
                upstream.stage.name,
                outputs.join(", ")
            );
            Err(GraphError {
                hint: port.hint,
                lacks: Some(output),
                ..GraphError::at_key(node.name, &edge.key, message)
            })
        }
    }
}

/// Nodes by index. Edges follow the flow of data.
type Flow = DiGraph<usize, ()>;

/// Returns the indices of nodes in topological order, ties in the order given.
fn topological_order(
    nodes: &[NodeShape<'_>],
    names: &BTreeMap<&str, usize>,
) -> Result<Vec<usize>, GraphError> {
    let mut flow = Flow::new();
    let indices: Vec<NodeIndex> = (0..nodes.len()).map(|index| flow.add_node(index)).collect();
    for (node, &index) in nodes.iter().zip(&indices) {
        let upstream = node.edges.iter().map(|edge| edge.upstream.as_str());
        for upstream in upstream.filter_map(|name| names.get(name)) {
            flow.update_edge(indices[*upstream], index, ());
        }
    }
    if let Some(path) = shortest_cycle(&flow) {
        let path: Vec<&str> = path.into_iter().map(|node| nodes[flow[node]].name).collect();
        let message = format!("the nodes form a cycle: {}", path.join(" -> "));
        return Err(GraphError::new(path[0], message));
    }
    Ok(in_order(&flow))
}

/// Returns the nodes of a graph without cycles in topological order (Kahn's algorithm), lowest index first.
fn in_order(flow: &Flow) -> Vec<usize> {
    let in_degree = |node| flow.neighbors_directed(node, Direction::Incoming).count();
    let mut left: Vec<usize> = flow.node_indices().map(in_degree).collect();
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

/// Returns a shortest cycle through the first node that is in one, by breadth-first search.
fn shortest_cycle(flow: &Flow) -> Option<Vec<NodeIndex>> {
    let components = tarjan_scc(flow).into_iter();
    let start = components
        .filter(|part| part.len() > 1 || flow.contains_edge(part[0], part[0]))
        .filter_map(|part| part.into_iter().min())
        .min()?;
    let mut predecessor: BTreeMap<NodeIndex, NodeIndex> = BTreeMap::new();
    let mut front = vec![start];
    while !predecessor.contains_key(&start) && !front.is_empty() {
        let mut next_front = Vec::new();
        for node in front {
            let mut next: Vec<NodeIndex> = flow.neighbors(node).collect();
            next.sort_unstable();
            next.retain(|next| !predecessor.contains_key(next));
            predecessor.extend(next.iter().map(|next| (*next, node)));
            next_front.extend(next);
        }
        front = next_front;
    }
    let mut path = vec![start];
    let mut at = *predecessor.get(&start)?;
    while at != start {
        path.push(at);
        at = *predecessor.get(&at)?;
    }
    path.push(start);
    path.reverse();
    Some(path)
}

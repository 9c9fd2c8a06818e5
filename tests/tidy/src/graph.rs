//! Circles in a graph.

use std::collections::{BTreeMap, BTreeSet};

/// Which node leads to which.
pub(crate) type Graph = BTreeMap<String, BTreeSet<String>>;

/// Returns the sets of two or more nodes that all lead to each other, the largest first.
pub(crate) fn circles(graph: &Graph) -> Vec<BTreeSet<String>> {
    let mut reverse = Graph::new();
    for (from, targets) in graph {
        for to in targets {
            reverse.entry(to.clone()).or_default().insert(from.clone());
        }
    }
    // Kosaraju: in the reversed graph, what is reached from the node that was left last is its circle.
    let mut order = Vec::new();
    let mut seen = BTreeSet::new();
    for node in graph.keys() {
        visit(graph, node, &mut seen, &mut order);
    }
    let mut found = Vec::new();
    let mut seen = BTreeSet::new();
    for node in order.iter().rev() {
        let mut circle = Vec::new();
        visit(&reverse, node, &mut seen, &mut circle);
        if circle.len() > 1 {
            found.push(circle.into_iter().collect::<BTreeSet<String>>());
        }
    }
    found.sort_by_key(|circle| std::cmp::Reverse(circle.len()));
    found
}

/// Visits all unseen nodes that a node leads to, and appends each after those it leads to.
fn visit(graph: &Graph, node: &str, seen: &mut BTreeSet<String>, order: &mut Vec<String>) {
    if !seen.insert(node.to_owned()) {
        return;
    }
    for next in graph.get(node).into_iter().flatten() {
        visit(graph, next, seen, order);
    }
    order.push(node.to_owned());
}

//! The checks of a graph, before anything runs.

use crate::common::*;
use marf_engine::{Graph, GraphError, NodeDecl};
use serde_json::json;

fn fault(nodes: Vec<NodeDecl>) -> GraphError {
    Graph::new(nodes, TABLE).err().unwrap()
}

fn archive() -> NodeDecl {
    node("archive", "archive", 0, json!({}), &[])
}

fn at_most(name: &str, input: &str) -> NodeDecl {
    node(
        name,
        "at_most",
        0,
        json!({ "most": 1 }),
        &[&format!("input={input}")],
    )
}

#[test]
fn a_cycle_is_printed_in_full() {
    let nodes = vec![
        archive(),
        at_most("a", "c"),
        at_most("b", "a"),
        at_most("c", "b"),
        at_most("d", "c"),
    ];
    assert_eq!(
        fault(nodes).to_string(),
        "the nodes form a cycle: a -> b -> c -> a"
    );
    assert_eq!(
        fault(vec![at_most("a", "a")]).to_string(),
        "the nodes form a cycle: a -> a"
    );
}

#[test]
fn a_name_that_is_not_there_or_twice_there_is_refused() {
    let unknown = fault(vec![archive(), at_most("a", "archiv")]);
    assert_eq!(
        unknown.to_string(),
        "`a.input` names the node `archiv`, which does not exist. The nodes are a, archive"
    );
    let twice = fault(vec![archive(), archive()]);
    assert_eq!(twice.to_string(), "two nodes are named `archive`");
}

#[test]
fn an_input_must_be_one_the_stage_has_and_the_upstream_gives() {
    let unconnected = node("a", "at_most", 0, json!({ "most": 1 }), &[]);
    assert_eq!(
        fault(vec![archive(), unconnected]).to_string(),
        "`a` needs `input`, the name of a node that gives `photos`"
    );
    let foreign = node(
        "a",
        "at_most",
        0,
        json!({ "most": 1 }),
        &["input=archive", "params=archive"],
    );
    assert_eq!(
        fault(vec![archive(), foreign]).to_string(),
        "`a` has no input `params`. Its inputs are input"
    );
    let draw = node("draw", "draw", 0, json!({ "seed": 1 }), &["input=archive"]);
    assert_eq!(
        fault(vec![archive(), draw]).to_string(),
        "`input` of `node.draw` needs `sum`, but `node.archive` (stage `archive`) gives photos, verdicts, companions"
    );
    let twice = node(
        "a",
        "at_most",
        0,
        json!({ "most": 1 }),
        &["input=archive", "input=archive"],
    );
    assert_eq!(
        fault(vec![archive(), twice]).to_string(),
        "`a` gets `input` twice"
    );
}

#[test]
fn an_optional_port_takes_what_there_is() {
    let sum = |input: &str| {
        node(
            "sum",
            "sum",
            0,
            json!({ "times": 1 }),
            &[&format!("input={input}")],
        )
    };
    assert!(Graph::new(vec![archive(), sum("archive")], TABLE).is_ok());
    assert!(Graph::new(vec![archive(), at_most("a", "archive"), sum("a")], TABLE).is_ok());
}

#[test]
fn the_order_is_topological_and_else_as_declared() {
    let nodes = vec![
        at_most("z", "archive"),
        at_most("b", "a"),
        at_most("a", "archive"),
        archive(),
    ];
    assert_eq!(
        Graph::new(nodes, TABLE).unwrap().names(),
        vec!["archive", "z", "a", "b"]
    );
}

#[test]
fn the_digest_of_a_graph_changes_with_every_part_of_it() {
    let digest = |name: &str, most: u64, input: &str| {
        let edge = format!("input={input}");
        let last = node(name, "at_most", 0, json!({ "most": most }), &[&edge]);
        Graph::new(vec![archive(), at_most("a", "archive"), last], TABLE)
            .unwrap()
            .digest()
    };
    let base = digest("b", 1, "a");
    assert_eq!(base, digest("b", 1, "a"));
    for other in [
        digest("c", 1, "a"),
        digest("b", 2, "a"),
        digest("b", 1, "archive"),
    ] {
        assert_ne!(base, other);
    }
}

/// Runs and listings name a pipeline by it.
#[test]
fn the_digest_of_a_graph_stays_what_it_was() {
    let nodes = vec![archive(), at_most("a", "archive"), at_most("b", "a")];
    let digest = Graph::new(nodes, TABLE).map(|graph| graph.digest().short());
    assert_eq!(digest.unwrap(), "95d952e0b400");
}

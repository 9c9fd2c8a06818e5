//! Expansions of several rounds: later children read what earlier ones gave.

use std::sync::Arc;

use crate::common::*;
use marf_engine::{Cancel, Graph, NodeState, Outcome, OutputName, PlanOptions, PlanState, plan, why};
use serde_json::json;

/// The nodes up to `sum`, then a knockout with this many draws and rounds.
fn knockout(fixture: u64, change: serde_json::Value) -> Graph {
    let mut nodes = TestPipeline::new(fixture).nodes();
    nodes.pop();
    let mut params = json!({ "first": 4, "rounds": 3, "unlucky": 99, "how": "by_text" });
    for (key, value) in change.as_object().unwrap() {
        params[key] = value.clone();
    }
    nodes.push(node("knockout", "knockout", fixture, params, &["input=sum"]));
    Graph::new(nodes, TABLE).unwrap()
}

/// Returns the nodes below `knockout` that ran.
fn children_that_ran(log: &EventLog) -> Vec<String> {
    let names = ran(log).into_iter();
    names
        .filter_map(|name| name.strip_prefix("knockout/").map(str::to_owned))
        .collect()
}

/// Draws are `seed * 7 % 5`, and the larger half stays. Seeds 0 1 2 3 draw 0 2 4 1. Seeds 10 and 11 draw 0 and 2. Seed 20 draws 0.
const ALL: &str = "sum 20 0\nsum 20 2\nsum 20 4\nsum 20 1\nsum 20 4 0\nsum 20 2 2\nsum 20 4 0 0\n";

#[test]
fn each_round_reads_the_one_before_and_all_are_reduced_in_the_order_of_the_requests() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let (record, log) = run_on(&knockout(number, json!({})), &store);
    assert_eq!(record.outcome, Outcome::Done, "{:?}", node_events(&log));
    assert_eq!(text(&store, &record, "knockout", "all"), ALL);
    assert_eq!(record.node("knockout").unwrap().counts["children"], 7);
    let reduced = fixture.reduced.load(std::sync::atomic::Ordering::Relaxed);
    assert_eq!((fixture.take_ran(), reduced), (1 + 7, 1));
    let key = record.node("knockout").unwrap().key.unwrap();
    let children = store.record(&key).unwrap().unwrap().children;
    assert_eq!(
        children.keys().map(String::as_str).collect::<Vec<_>>(),
        ["7-0", "8-0", "8-1", "9-0", "9-1", "9-2", "9-3"],
        "the record names the children of all rounds"
    );
}

#[test]
fn what_is_stored_is_told_as_it_was_made() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let graph = knockout(number, json!({}));
    let (first, _) = run_on(&graph, &store);
    let made_by = |node: &str| {
        let inputs = &first.node(node).unwrap().inputs;
        inputs["sum"].made_by.clone().unwrap()
    };
    let output = |node: &str, output: &str| OutputName {
        node: node.to_owned(),
        output: output.to_owned(),
    };
    assert_eq!(made_by("knockout/9-2"), output("sum", "sum"));
    assert_eq!(made_by("knockout/8-0"), output("knockout/9-2", "draw"));
    assert_eq!(made_by("knockout/7-0"), output("knockout/8-0", "draw"));

    let planned = plan(&graph, &store, Some(&first), &PlanOptions::default()).unwrap();
    assert!(
        planned.iter().all(|node| node.state == PlanState::Fresh),
        "{planned:?}"
    );
    fixture.take_ran();
    let (again, log) = run_on(&graph, &store);
    assert_eq!((ran(&log), fixture.take_ran()), (Vec::new(), 0));
    // Sorted by name, the last round would come before the outputs that it read.
    let nodes = |record: &marf_engine::RunRecord| -> Vec<_> {
        let nodes = record.nodes.iter();
        nodes
            .map(|node| (node.name.clone(), node.key, node.inputs.clone()))
            .collect()
    };
    assert_eq!(nodes(&again), nodes(&first));
}

#[test]
fn another_round_runs_alone_and_the_plan_tells_why() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let (first, _) = run_on(&knockout(number, json!({ "rounds": 2 })), &store);
    let more = knockout(number, json!({ "rounds": 3 }));
    let planned = why(&more, &store, Some(&first), &PlanOptions::default(), "knockout").unwrap();
    assert_eq!(planned.reason, "params.rounds: 2 -> 3");
    let (record, log) = run_on(&more, &store);
    assert_eq!(children_that_ran(&log), ["7-0"]);
    assert_eq!(text(&store, &record, "knockout", "all"), ALL);
}

#[test]
fn stopped_in_its_second_round_it_goes_on_there() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let graph = knockout(number, json!({}));
    let cancel = Cancel::default();
    let stop = cancel.clone();
    // The sum and four draws come before.
    *fixture.at_draw.lock() = Some(Arc::new(move |before| {
        if before == 1 + 4 {
            stop.set();
        }
    }));
    let (record, log) = run_with(&graph, &store, &options(1), &cancel);
    assert_eq!(record.outcome, Outcome::Cancelled, "{:?}", node_events(&log));
    assert_eq!(record.node("knockout").unwrap().state, NodeState::Cancelled);
    *fixture.at_draw.lock() = None;
    assert_eq!(fixture.take_ran(), 1 + 4 + 1);

    let (record, log) = run_on(&graph, &store);
    assert_eq!(reason_of(&log, "knockout").unwrap(), "the last run was stopped");
    assert_eq!(children_that_ran(&log), ["7-0", "8-1"], "{:?}", node_events(&log));
    assert_eq!(text(&store, &record, "knockout", "all"), ALL);
}

#[test]
fn a_child_of_a_later_round_that_fails_is_named_and_earlier_ones_are_kept() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let (record, _) = run_on(&knockout(number, json!({ "unlucky": 1 })), &store);
    let failed = record.node("knockout").unwrap();
    assert_eq!(failed.state, NodeState::Failed);
    assert_eq!(failed.reason, "1 of 6 of its nodes failed, first `knockout/8-0`");
    let (_, log) = run_on(&knockout(number, json!({})), &store);
    assert_eq!(children_that_ran(&log), ["7-0", "8-0"]);
}

#[test]
fn a_name_of_an_earlier_round_is_refused() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let (record, _) = run_on(&knockout(number, json!({ "how": "repeated" })), &store);
    let reason = &record.node("knockout").unwrap().reason;
    assert!(reason.contains("it asks for `knockout/9-0` twice"), "{reason}");
    assert_eq!(record.outcome, Outcome::Failed);
}

/// A child of the last round reads an output of the first round, which must be computed again first.
#[test]
fn whatever_object_is_damaged_a_further_round_heals_it() {
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    for how in ["by_text", "unread"] {
        let before = knockout(number, json!({ "rounds": 2, "how": how }));
        let after = knockout(number, json!({ "rounds": 3, "how": how }));
        let objects = damage_each_object(&before, &after);
        assert!(objects > 20, "{how}: {objects}");
    }
}

//! Comparisons: what is summarised and decided again when photos change what others are compared with.

use std::sync::Arc;

use crate::common::*;
use marf_cache::{Action, Store};
use marf_engine::{Cancel, Graph, NodeState, Outcome, PlanOptions, RunRecord, plan};
use proptest::prelude::*;
use serde_json::json;

/// An archive, a comparison and a sum.
fn graph(fixture: u64, enough: u64) -> Graph {
    let sum = |name, upstream| node(name, "sum", fixture, json!({ "times": 1 }), &[upstream]);
    let nodes = vec![
        node("archive", "archive", fixture, json!({}), &[]),
        node(
            "crowd",
            "crowd",
            fixture,
            json!({ "enough": enough }),
            &["input=archive"],
        ),
        sum("sum", "input=crowd"),
    ];
    Graph::new(nodes, TABLE).unwrap()
}

/// Returns how many shards a run decided, how many summaries and how many measures it made.
fn counts(record: &RunRecord) -> (u64, u64, u64) {
    let counts = &record.node("crowd").unwrap().counts;
    (counts["decided"], counts["summarised"], counts["measured"])
}

/// A store after a run over the numbers 0 to 9 and the even ones to 18: of the tens 0 and 1, the higher has five photos.
fn after_first_run() -> (tempfile::TempDir, Store, u64, Arc<Fixture>, RunRecord) {
    let (dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    (1..=2).for_each(|shard| fixture.put_shard(shard));
    let (record, log) = run_on(&graph(number, 5), &store);
    assert_eq!(record.outcome, Outcome::Done, "{:?}", node_events(&log));
    (dir, store, number, fixture, record)
}

/// Asserts that a run has the outputs of one on an empty store.
fn assert_as_anew(record: &RunRecord, graph: &Graph) {
    let (_dir, empty) = fresh_store();
    let (anew, _) = run_on(graph, &empty);
    for node in &anew.nodes {
        assert_eq!(
            record.node(&node.name).unwrap().outputs,
            node.outputs,
            "{}",
            node.name
        );
    }
}

#[test]
fn the_first_run_summarises_all_shards_in_each_pass_and_decides_them_once() {
    let (_dir, store, number, _fixture, record) = after_first_run();
    assert_eq!(counts(&record), (2, 4, 20));
    assert_eq!(text(&store, &record, "sum", "sum"), "sum 135");
    let (record, _) = run_on(&graph(number, 6), &store);
    assert_eq!(
        text(&store, &record, "sum", "sum"),
        "sum 65",
        "five are not enough: 10 to 18 go"
    );
}

#[test]
fn a_new_shard_that_changes_no_context_is_summarised_and_decided_alone() {
    let (_dir, store, number, fixture, _) = after_first_run();
    fixture.put(3, "more", 15);
    let (record, _) = run_on(&graph(number, 5), &store);
    assert_eq!(counts(&record), (1, 2, 1));
    assert_as_anew(&record, &graph(number, 5));
    let (record, log) = run_on(&graph(number, 5), &store);
    assert_eq!(ran(&log), Vec::<String>::new());
    assert_eq!(record.outcome, Outcome::Done);
}

#[test]
fn a_context_that_changes_decides_all_shards_again_from_kept_measures() {
    let (_dir, store, number, fixture, _) = after_first_run();
    fixture.put(3, "higher", 25);
    let (record, _) = run_on(&graph(number, 5), &store);
    assert_eq!(
        counts(&record),
        (3, 1 + 3, 1),
        "the second pass looks at the context of the first"
    );
    assert_as_anew(&record, &graph(number, 5));
    fixture.archive.lock().remove(&3);
    let (record, log) = run_on(&graph(number, 5), &store);
    assert_eq!(ran(&log), Vec::<String>::new(), "the set before has its result");
    assert_eq!(record.outcome, Outcome::Done);
}

#[test]
fn a_new_threshold_summarises_nothing_and_an_equal_context_decides_what_has_other_params() {
    let (_dir, store, number, _fixture, _) = after_first_run();
    let (record, log) = run_on(&graph(number, 4), &store);
    assert_eq!(counts(&record), (2, 0, 0));
    assert_eq!(
        ran(&log),
        ["crowd"],
        "the result is the same, so nothing below it runs"
    );
    assert_eq!(record.node("sum").unwrap().state, NodeState::Reused);
}

#[test]
fn no_photos_have_a_context_too() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put(1, "a", 50);
    let nodes = vec![
        node("archive", "archive", number, json!({}), &[]),
        node(
            "at_most",
            "at_most",
            number,
            json!({ "most": 12 }),
            &["input=archive"],
        ),
        node(
            "crowd",
            "crowd",
            number,
            json!({ "enough": 1 }),
            &["input=at_most"],
        ),
    ];
    let (record, log) = run_on(&Graph::new(nodes, TABLE).unwrap(), &store);
    assert_eq!(record.outcome, Outcome::Done, "{:?}", node_events(&log));
    assert_eq!(counts(&record), (0, 0, 0));
}

#[test]
fn stopped_between_its_passes_it_goes_on_where_it_was() {
    for (pass, left) in [(0, (2, 2, 0)), (1, (2, 0, 0))] {
        let (_dir, store) = fresh_store();
        let (number, fixture) = new_fixture();
        (1..=2).for_each(|shard| fixture.put_shard(shard));
        let (cancel, graph) = (Cancel::default(), graph(number, 5));
        let stop = cancel.clone();
        let stop_at = move |at| {
            if at == pass {
                stop.set();
            }
        };
        *fixture.at_context.lock() = Some(Arc::new(stop_at));
        let (record, _) = run_with(&graph, &store, &options(2), &cancel);
        assert_eq!(
            record.node("crowd").unwrap().state,
            NodeState::Cancelled,
            "pass {pass}"
        );
        *fixture.at_context.lock() = None;
        let (record, _) = run_on(&graph, &store);
        assert_eq!(record.outcome, Outcome::Done);
        assert_eq!(counts(&record), left, "stopped in pass {pass}");
        assert_as_anew(&record, &graph);
    }
}

#[test]
fn whatever_object_is_damaged_a_comparison_heals() {
    let (_dir, _store, number, fixture, _) = after_first_run();
    let objects = damage_each_object(&graph(number, 5), &graph(number, 6));
    assert!(objects > 30, "{objects}");
    fixture.put(3, "higher", 25);
    damage_each_object(&graph(number, 5), &graph(number, 1));
}

/// Its record and its place in the index are there, its bytes are not: that is found when it is read.
#[test]
fn a_damaged_summary_is_made_again_alone() {
    let (_dir, store, number, _fixture, first) = after_first_run();
    let parts = store
        .record(&first.node("crowd").unwrap().key.unwrap())
        .unwrap()
        .unwrap()
        .parts;
    let mut damaged = 0;
    for part in set_of(&store, &parts.unwrap())
        .leaves
        .iter()
        .filter(|part| part.shard == 2)
    {
        if let Some(summary) = store.record(&part.leaf).unwrap().unwrap().outputs.get("summary") {
            damage_object(&store, &summary.digest);
            damaged += 1;
        }
    }
    assert_eq!(damaged, 2, "one a pass");
    let (record, log) = run_on(&graph(number, 4), &Store::open(store.dir()).unwrap());
    assert_eq!(record.outcome, Outcome::Done, "{:?}", node_events(&log));
    assert_eq!(counts(&record), (2, 2, 0));
    assert_eq!(ran(&log), ["crowd"], "nothing above it runs for that");
}

#[test]
fn summaries_are_parts_of_the_result_and_hold_no_parameter() {
    let (_dir, store, _number, _fixture, first) = after_first_run();
    let parts = store
        .record(&first.node("crowd").unwrap().key.unwrap())
        .unwrap()
        .unwrap()
        .parts;
    let leaves = set_of(&store, &parts.unwrap()).leaves;
    let actions = leaves.iter().map(|part| {
        let action = Action::decode(&store.get(&part.leaf).unwrap()).unwrap();
        assert_eq!(action.shard, Some(part.shard));
        let inputs: Vec<_> = action.inputs.into_keys().collect();
        (
            part.shard,
            action.part.unwrap(),
            action.params.to_string(),
            inputs.join(" "),
        )
    });
    let expected = |shard| {
        [
            ("summarise", r#"{"pass":"highest"}"#, "rows.0"),
            ("summarise", r#"{"pass":"crowd"}"#, "context rows.0"),
            ("decide", r#"{"enough":5}"#, "context rows.0"),
        ]
        .map(|(part, params, inputs)| (shard, part.to_owned(), params.to_owned(), inputs.to_owned()))
    };
    assert_eq!(actions.collect::<Vec<_>>(), [expected(1), expected(2)].concat());
}

#[test]
fn the_plan_tells_what_is_surely_looked_at() {
    let (_dir, store, number, fixture, first) = after_first_run();
    let extent = |enough| {
        let planned = plan(
            &graph(number, enough),
            &store,
            Some(&first),
            &PlanOptions::default(),
        )
        .unwrap();
        let crowd = planned.into_iter().find(|node| node.node == "crowd").unwrap();
        crowd.extent.map(|extent| (extent.shards, extent.photos))
    };
    assert_eq!(extent(5), None);
    assert_eq!(
        extent(4),
        Some((2, Some(20))),
        "all summaries are known, no decision"
    );
    fixture.put(3, "more", 15);
    let to_archive = marf_engine::Options {
        to: vec!["archive".to_owned()],
        ..options(2)
    };
    run_with(&graph(number, 5), &store, &to_archive, &Cancel::default());
    assert_eq!(extent(5), Some((1, Some(1))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]

    /// A run gives the same answer as on an empty store, whatever ran before.
    #[test]
    fn any_history_gives_the_answers_of_no_history(
        steps in prop::collection::vec((1_u32..4, 0_u64..40, 1_u64..8), 1..5)
    ) {
        let (_dir, store) = fresh_store();
        let (number, fixture) = new_fixture();
        for (shard, value, enough) in steps {
            fixture.put(shard, &format!("s{shard}-{}", value % 5), value);
            let graph = graph(number, enough);
            let (record, _) = run_on(&graph, &store);
            prop_assert_eq!(record.outcome, Outcome::Done);
            assert_as_anew(&record, &graph);
        }
    }
}

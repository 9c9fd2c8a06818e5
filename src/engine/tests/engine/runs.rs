//! Runs as they are recorded and selected, and sets of unusual sizes.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use crate::common::*;
use crate::what_ran::after_first_run;
use proptest::prelude::*;

use marf_engine::{
    Event, Listener, NodeState, Outcome, PlanOptions, PlanState, RunRecord, RunSource, StateListener,
    last_run, plan, runs,
};

#[test]
fn runs_are_kept_in_order_and_carry_the_latest_keys() {
    let (_dir, store, pipeline, _fixture, first) = after_first_run();
    let mut options = options(1);
    options.to = vec!["at_most".to_owned()];
    let (second, _) = run_with(
        &pipeline.graph(),
        &store,
        &options,
        &marf_engine::Cancel::default(),
    );
    assert_eq!(second.nodes.len(), 2);
    assert_eq!(second.latest, first.latest, "a short run forgets nothing");
    let all = runs(&store, no_warning).unwrap();
    assert_eq!(all.iter().map(|run| run.number).collect::<Vec<_>>(), vec![1, 2]);
    assert_eq!(all[1], second);
    assert_eq!(
        last_run(&store, "test", &RunSource::default(), no_warning).unwrap(),
        Some(second)
    );
    assert_eq!(
        last_run(&store, "another", &RunSource::default(), no_warning).unwrap(),
        None
    );
}

#[test]
fn to_runs_what_leads_there_and_from_what_follows() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let graph = TestPipeline::new(number).graph();
    let with = |to: &[&str], from: &[&str]| {
        let mut options = options(2);
        options.to = to.iter().map(|&name| name.to_owned()).collect();
        options.from = from.iter().map(|&name| name.to_owned()).collect();
        run_with(&graph, &store, &options, &marf_engine::Cancel::default())
    };
    let (record, log) = with(&[], &["sum"]);
    assert_eq!(record.outcome, Outcome::Failed);
    let told = node_events(&log);
    assert_eq!(told[0].0, "sum");
    assert!(
        told[0].1.contains("distinct is not among the nodes to run"),
        "{told:?}"
    );
    let (_, log) = with(&["distinct"], &[]);
    assert_eq!(ran(&log), vec!["archive", "at_most", "distinct"]);
    let (record, log) = with(&["sum"], &["sum"]);
    assert_eq!(record.outcome, Outcome::Done);
    assert_eq!(ran(&log), vec!["sum"]);
    assert!(record.node("many").is_none());
}

#[test]
fn the_plan_says_never_ran_and_writes_nothing() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let planned = plan(
        &TestPipeline::new(number).graph(),
        &store,
        None,
        &PlanOptions::default(),
    )
    .unwrap();
    assert_eq!(planned[0].reason, "never ran");
    assert_eq!(planned[1].reason, "upstream archive will run");
    assert!(planned.iter().all(|node| node.state == PlanState::WillRun));
    let stat = store.stat().unwrap();
    assert_eq!((stat.records, stat.packs, stat.runs), (0, 0, 0));
}

#[test]
fn independent_nodes_and_members_run_side_by_side() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    // Each sum waits until the other has begun. One after the other, they would wait in vain.
    let begun = AtomicU64::new(0);
    let meet = move || {
        begun.fetch_add(1, Ordering::SeqCst);
        let deadline = Instant::now() + Duration::from_secs(20);
        while begun.load(Ordering::SeqCst) < 2 {
            assert!(Instant::now() < deadline, "the other did not begin");
            std::thread::yield_now();
        }
    };
    *fixture.at_sum.lock() = Some(Arc::new(meet));
    let json = serde_json::json!({ "times": 1 });
    let nodes = vec![
        node("archive", "archive", number, serde_json::json!({}), &[]),
        node("one", "sum", number, json, &["input=archive"]),
        node(
            "two",
            "sum",
            number,
            serde_json::json!({ "times": 2 }),
            &["input=archive"],
        ),
    ];
    let graph = marf_engine::Graph::new(nodes, TABLE).unwrap();
    let (record, _) = run_on(&graph, &store);
    assert_eq!(text(&store, &record, "one", "sum"), "sum 45");
    assert_eq!(text(&store, &record, "two", "sum"), "sum 90");
    assert_eq!(
        fixture.sum_threads.lock().clone(),
        vec![1, 1],
        "each gets its share"
    );
}

/// Keeps the records of a run that goes on.
#[derive(Default)]
struct States(parking_lot::Mutex<Vec<RunRecord>>);

impl Listener for States {
    fn on_event(&self, _event: &Event) {}
}

impl StateListener for States {
    fn on_state(&self, record: &dyn Fn() -> Option<RunRecord>) {
        self.0.lock().extend(record());
    }
}

#[test]
fn a_run_that_goes_on_tells_what_it_has_and_a_node_shares_with_none_of_one_thread() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let nodes = vec![
        node("archive", "archive", number, serde_json::json!({}), &[]),
        node(
            "sum",
            "sum",
            number,
            serde_json::json!({ "times": 1 }),
            &["input=archive"],
        ),
        node(
            "broken",
            "broken",
            number,
            serde_json::json!({ "how": "error" }),
            &["input=archive"],
        ),
    ];
    let graph = marf_engine::Graph::new(nodes, TABLE).unwrap();
    let states = States::default();
    let cancel = marf_engine::Cancel::default();
    let last = marf_engine::run_nodes(&graph, &store, &options(2), &states, &cancel).unwrap();
    assert!(!last.goes_on());
    assert_eq!(fixture.sum_threads.lock().clone(), vec![2]);
    let states = states.0.into_inner();
    assert!(states.iter().all(RunRecord::goes_on));
    let ended =
        |record: &RunRecord| -> Vec<NodeState> { record.nodes.iter().map(|node| node.state).collect() };
    let [open, done] = [NodeState::Cancelled, NodeState::Finished];
    for expected in [[open, open, open], [done, open, open], [done, done, open]] {
        let found = states.iter().any(|record| ended(record) == expected);
        assert!(
            found,
            "{expected:?}: {:?}",
            states.iter().map(ended).collect::<Vec<_>>()
        );
    }
    let sum = states
        .iter()
        .find(|record| ended(record) == [done, done, open])
        .unwrap();
    assert_eq!(text(&store, sum, "sum", "sum"), "sum 45");
    assert_eq!(sum.node("sum"), last.node("sum"));
}

#[test]
fn a_shard_of_more_rows_than_a_leaf_holds_is_one_shard_still() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    let rows = marf_cache::manifest::ROWS_A_LEAF as u64 + 1;
    (0..rows).for_each(|row| fixture.put(7, &format!("{row:05}"), row));
    let pipeline = TestPipeline {
        most: rows - 2, // the last row goes, so the rest fits one leaf
        by: 1,
        ..TestPipeline::new(number)
    };
    let (record, _) = run_on(&pipeline.graph(), &store);
    let leaves = |node: &str| {
        let root = record.node(node).unwrap().outputs["photos"].digest;
        let root = set_of(&store, &root);
        root.leaves
            .iter()
            .map(|leaf| (leaf.shard, leaf.rows))
            .collect::<Vec<_>>()
    };
    assert_eq!(leaves("archive"), vec![(7, 4000), (7, 1)]);
    assert_eq!(leaves("at_most"), vec![(7, 4000)]);
    assert_eq!(fixture.take_folded(), vec![7]);
    assert_eq!(record.node("distinct").unwrap().counts["photos"], 4000);
}

#[test]
fn a_set_of_which_nothing_stays_is_no_failure_of_the_engine() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put(1, "a", 50);
    let (record, _) = run_on(&TestPipeline::new(number).graph(), &store);
    assert_eq!(record.outcome, Outcome::Done);
    let counts = &record.node("at_most").unwrap().counts;
    assert_eq!((counts["photos"], counts["rejected"]), (0, 1));
    assert_eq!(text(&store, &record, "sum", "sum"), "sum 0");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4))]

    /// A run gives the same answer as on an empty store, whatever ran before.
    #[test]
    fn any_history_gives_the_answers_of_no_history(
        steps in prop::collection::vec((0_u64..30, 1_u64..4, 1_u64..5, 1_u32..5), 2..4)
    ) {
        let (_dir, store) = fresh_store();
        let (number, fixture) = new_fixture();
        fixture.put_shard(2);
        for (most, by, b, shard) in steps {
            fixture.put_shard(shard);
            fixture.put(2, "s2-0", most);
            let pipeline = TestPipeline { most, by, b, ..TestPipeline::new(number) };
            let (_dir2, empty) = fresh_store();
            let (with, _) = run_on(&pipeline.graph(), &store);
            let (without, _) = run_on(&pipeline.graph(), &empty);
            prop_assert_eq!(with.nodes.len(), without.nodes.len());
            for (one, two) in with.nodes.iter().zip(&without.nodes) {
                prop_assert_eq!((&one.name, one.key, &one.outputs), (&two.name, two.key, &two.outputs));
            }
        }
    }
}

//! A node that reads its own last output. It continues from there, and never runs because of its own output alone.

use crate::common::*;
use marf_cache::{Action, Store};
use marf_engine::{
    Graph, NodeState, Outcome, PlanOptions, PlanState, RunRecord, RunSource, last_run, plan, why,
};

/// The archive, its sum times a number, and a list of its results.
struct AppendPipeline {
    fixture: u64,
    times: u64,
    extend: bool,
}

impl AppendPipeline {
    fn graph(&self) -> Graph {
        let json = |key: &str, value: serde_json::Value| serde_json::json!({ key: value });
        let nodes = vec![
            node("archive", "archive", self.fixture, serde_json::json!({}), &[]),
            node(
                "sum",
                "sum",
                self.fixture,
                json("times", self.times.into()),
                &["input=archive"],
            ),
            node(
                "append",
                "append",
                self.fixture,
                json("extend", self.extend.into()),
                &["input=sum"],
            ),
        ];
        Graph::new(nodes, TABLE).unwrap()
    }

    /// Plans and runs. The two must agree on the node, its key and whether it runs.
    fn run(&self, store: &Store) -> (RunRecord, NodeState, EventLog) {
        let last = last_run(store, "test", &RunSource::default(), no_warning).unwrap();
        let planned = plan(&self.graph(), store, last.as_ref(), &PlanOptions::default())
            .unwrap()
            .remove(2);
        let (record, log) = run_on(&self.graph(), store);
        assert_eq!(record.outcome, Outcome::Done, "{:?}", node_events(&log));
        let node = record.node("append").unwrap();
        let state = node.state;
        match planned.state {
            PlanState::MayRun => assert!(planned.key.is_none(), "{planned:?}"),
            planned => assert_eq!(planned == PlanState::WillRun, state == NodeState::Finished),
        }
        assert!(planned.key.is_none_or(|key| Some(key) == node.key), "{planned:?}");
        (record, state, log)
    }
}

/// A store, and a pipeline that has appended `sum 45`.
fn begun() -> (tempfile::TempDir, Store, AppendPipeline) {
    let (dir, store) = fresh_store();
    let (fixture, archive) = new_fixture();
    archive.put_shard(1);
    let pipeline = AppendPipeline {
        fixture,
        times: 1,
        extend: true,
    };
    let (record, state, log) = pipeline.run(&store);
    assert_eq!(
        (state, reason_of(&log, "append").unwrap().as_str()),
        (NodeState::Finished, "never ran")
    );
    assert_eq!(text(&store, &record, "append", "appended"), "sum 45\n");
    (dir, store, pipeline)
}

#[test]
fn what_changed_is_added_to_the_last_output_and_without_a_change_nothing_runs() {
    let (_dir, store, mut pipeline) = begun();
    assert_eq!(pipeline.run(&store).1, NodeState::Reused);
    pipeline.times = 2;
    let (record, state, log) = pipeline.run(&store);
    assert_eq!(state, NodeState::Finished);
    assert_eq!(text(&store, &record, "append", "appended"), "sum 45\nsum 90\n");
    assert_eq!(reason_of(&log, "append").unwrap(), "input sum changed");
    for _ in 0..3 {
        let (again, state, _) = pipeline.run(&store);
        assert_eq!(
            (state, again.node("append").unwrap().key),
            (NodeState::Reused, record.node("append").unwrap().key)
        );
    }
    pipeline.times = 1;
    let (record, _, _) = pipeline.run(&store);
    assert_eq!(
        text(&store, &record, "append", "appended"),
        "sum 45\nsum 90\nsum 45\n"
    );
    assert_eq!(pipeline.run(&store).1, NodeState::Reused);
}

#[test]
fn the_earlier_output_stands_in_the_key_and_among_the_changes() {
    let (_dir, store, mut pipeline) = begun();
    let first = last_run(&store, "test", &RunSource::default(), no_warning)
        .unwrap()
        .unwrap();
    pipeline.times = 2;
    pipeline.run(&store);
    let key = last_run(&store, "test", &RunSource::default(), no_warning)
        .unwrap()
        .unwrap()
        .latest["append"];
    let action = Action::decode(&store.get(&key).unwrap()).unwrap();
    let earlier = first.node("append").unwrap().outputs["appended"].digest;
    assert_eq!(action.inputs["earlier"], earlier);

    pipeline.times = 3;
    run_with(
        &pipeline.graph(),
        &store,
        &only("sum"),
        &marf_engine::Cancel::default(),
    );
    let last = last_run(&store, "test", &RunSource::default(), no_warning).unwrap();
    let planned = why(
        &pipeline.graph(),
        &store,
        last.as_ref(),
        &PlanOptions::default(),
        "append",
    )
    .unwrap();
    let changes: Vec<String> = planned.changes.iter().map(ToString::to_string).collect();
    assert_eq!(changes, ["input sum changed", "input earlier changed"]);
}

fn only(to: &str) -> marf_engine::Options {
    marf_engine::Options {
        to: vec![to.to_owned()],
        ..options(1)
    }
}

#[test]
fn without_the_wish_there_is_no_such_input_and_with_it_the_last_output_counts() {
    let (_dir, store, mut pipeline) = begun();
    (pipeline.extend, pipeline.times) = (false, 2);
    let (record, _, _) = pipeline.run(&store);
    assert_eq!(text(&store, &record, "append", "appended"), "sum 90\n");
    pipeline.extend = true;
    let (record, _, log) = pipeline.run(&store);
    assert_eq!(reason_of(&log, "append").unwrap(), "params.extend: false -> true");
    assert_eq!(text(&store, &record, "append", "appended"), "sum 90\nsum 90\n");
    assert_eq!(pipeline.run(&store).1, NodeState::Reused);
}

#[test]
fn an_earlier_output_that_is_damaged_is_none() {
    let (dir, store, mut pipeline) = begun();
    drop(store);
    for entry in std::fs::read_dir(dir.path().join(".marf/packs")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|end| end == "pack") {
            let mut bytes = std::fs::read(&path).unwrap();
            let earlier = bytes.windows(7).position(|part| part == b"sum 45\n");
            earlier.into_iter().for_each(|at| bytes[at + 5] = b'4');
            std::fs::write(&path, bytes).unwrap();
        }
    }
    let store = Store::open(dir.path().join(".marf")).unwrap();
    pipeline.times = 2;
    let (record, _) = run_on(&pipeline.graph(), &store);
    assert_eq!(record.outcome, Outcome::Done);
    assert_eq!(text(&store, &record, "append", "appended"), "sum 90\n");
}

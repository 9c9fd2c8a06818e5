//! Failures, stops, kills, and several programs on one store.

use std::{
    path::Path,
    sync::{Arc, Barrier},
};

use crate::common::*;
use marf_cache::{Digest, Store};
use marf_engine::{Cancel, Event, Graph, NodeState, Outcome, PlanOptions, plan};

fn broken_graph(fixture: u64, how: &str) -> Graph {
    let mut nodes = TestPipeline::new(fixture).nodes();
    let how = serde_json::json!({ "how": how });
    nodes.push(node("broken", "broken", fixture, how, &["input=at_most"]));
    nodes.push(node(
        "below",
        "draw",
        fixture,
        serde_json::json!({ "seed": 1 }),
        &["input=broken"],
    ));
    let below = node(
        "far_below",
        "many",
        fixture,
        serde_json::json!({ "b": 1, "unlucky": 99 }),
        &["input=broken"],
    );
    nodes.push(below);
    Graph::new(nodes, TABLE).unwrap()
}

#[test]
fn a_failing_node_skips_what_depends_on_it_and_nothing_else() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let (record, log) = run_on(&broken_graph(number, "fails"), &store);
    assert_eq!(record.outcome, Outcome::Failed);
    let broken = record.node("broken").unwrap();
    let why = [
        Some(broken.reason.as_str()),
        broken.cause.as_deref(),
        broken.hint.as_deref(),
    ];
    assert_eq!(
        why,
        [Some("no number is right"), Some("numbers"), Some("use letters")]
    );
    assert_eq!(record.node("below").unwrap().state, NodeState::Skipped);
    assert_eq!(record.node("below").unwrap().reason, "broken failed");
    assert_eq!(record.node("far_below").unwrap().reason, "broken failed");
    assert_eq!(record.node("many").unwrap().state, NodeState::Finished);
    let failed = Event::Failed {
        node: "broken".into(),
        message: "no number is right".into(),
        cause: Some("numbers".into()),
        hint: Some("use letters".into()),
    };
    assert!(log.0.lock().contains(&failed));
    let (again, log) = run_on(&broken_graph(number, "fails"), &store);
    assert_eq!(reason_of(&log, "broken").unwrap(), "it failed in the last run");
    assert_eq!(
        again.node("many").unwrap().state,
        NodeState::Reused,
        "what was computed stays"
    );
}

#[test]
fn a_stage_that_panics_or_breaks_its_contract_is_a_failed_node_that_says_so() {
    let cases = [
        ("panics", "panicked: index 7 of 3"),
        ("forgets", "its output `sum` did not come"),
        ("invents", "output `sum` names a blob that is not in the store"),
        ("adds", "its output `more` is not declared"),
    ];
    for (how, expected) in cases {
        let (_dir, store) = fresh_store();
        let (number, fixture) = new_fixture();
        fixture.put_shard(1);
        let (record, _) = run_on(&broken_graph(number, how), &store);
        assert_eq!(record.outcome, Outcome::Failed);
        assert_eq!(record.node("broken").unwrap().reason, expected);
        assert_eq!(record.node("sum").unwrap().state, NodeState::Finished, "{how}");
    }
}

#[test]
fn an_archive_that_cannot_be_listed_fails_with_its_hint() {
    let (_dir, store) = fresh_store();
    let (number, _fixture) = new_fixture();
    let graph = TestPipeline::new(number).graph();
    let planned = plan(&graph, &store, None, &PlanOptions::default()).unwrap();
    assert_eq!(
        planned[0].reason,
        "it cannot list what is there: the archive is empty"
    );
    let (record, log) = run_on(&graph, &store);
    assert_eq!(record.outcome, Outcome::Failed);
    assert_eq!(record.node("many").unwrap().reason, "sum was skipped");
    let events = log.0.lock();
    assert!(
        matches!(&events[0], Event::Failed { hint: Some(hint), .. } if hint == "fill it"),
        "{events:?}"
    );
}

#[test]
fn of_failing_members_the_others_are_kept() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let pipeline = TestPipeline {
        b: 15,
        unlucky: 13,
        ..TestPipeline::new(number)
    };
    let (record, _) = run_on(&pipeline.graph(), &store);
    let many = record.node("many").unwrap();
    assert_eq!(many.state, NodeState::Failed);
    assert_eq!(many.reason, "1 of 15 of its nodes failed, first `many/member-13`");
    let member = record.node("many/member-13").unwrap();
    assert!(
        many.cause.as_ref().unwrap().starts_with(&member.reason),
        "{:?}",
        many.cause
    );
    let (_, log) = run_on(&TestPipeline { b: 12, ..pipeline }.graph(), &store);
    assert_eq!(ran(&log), vec!["many"]);
}

#[test]
fn stopped_in_the_middle_it_goes_on_where_it_was() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    (1..=3).for_each(|shard| fixture.put_shard(shard));
    let cancel = Cancel::default();
    let stop = cancel.clone();
    let at = move |before| {
        if before == 11 {
            stop.set()
        }
    };
    *fixture.at_measure.lock() = Some(Box::new(at));
    let graph = TestPipeline::new(number).graph();
    let (record, _) = run_with(&graph, &store, &options(1), &cancel);
    assert_eq!(record.outcome, Outcome::Cancelled);
    assert_eq!(record.node("at_most").unwrap().state, NodeState::Cancelled);
    assert_eq!(record.node("many").unwrap().reason, "the run was stopped");
    assert_eq!(fixture.take_measured(), 12);
    *fixture.at_measure.lock() = None;

    let (record, log) = run_on(&graph, &store);
    assert_eq!(record.outcome, Outcome::Done);
    assert_eq!(reason_of(&log, "at_most").unwrap(), "the last run was stopped");
    assert_eq!(record.node("archive").unwrap().state, NodeState::Reused);
    assert_eq!(record.node("at_most").unwrap().counts["measured"], 30 - 12);
    let (_dir2, other) = fresh_store();
    let (anew, _) = run_on(&graph, &other);
    assert_eq!(
        record.node("many").unwrap().outputs,
        anew.node("many").unwrap().outputs
    );
}

#[test]
fn a_set_stage_that_hears_the_wish_to_stop_is_stopped_not_failed() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let cancel = Cancel::default();
    let stop = cancel.clone();
    *fixture.at_sum.lock() = Some(Arc::new(move || stop.set()));
    let (record, _) = run_with(&TestPipeline::new(number).graph(), &store, &options(2), &cancel);
    assert_eq!(record.outcome, Outcome::Cancelled);
    assert_eq!(record.node("sum").unwrap().state, NodeState::Cancelled);
    assert_eq!(record.node("distinct").unwrap().state, NodeState::Finished);
}

#[test]
fn two_programs_on_one_store_share_the_work_and_agree() {
    let (dir, _store) = fresh_store();
    let (number, fixture) = new_fixture();
    (1..=4).for_each(|shard| fixture.put_shard(shard));
    let start = Barrier::new(2);
    let records: Vec<_> = std::thread::scope(|scope| {
        let program = || {
            let store = Store::open(dir.path().join(".marf")).unwrap();
            start.wait();
            run_on(
                &TestPipeline {
                    b: 8,
                    ..TestPipeline::new(number)
                }
                .graph(),
                &store,
            )
            .0
        };
        let threads = [scope.spawn(program), scope.spawn(program)];
        threads.map(|thread| thread.join().unwrap()).into_iter().collect()
    });
    for node in &records[0].nodes {
        assert_eq!(
            node.outputs,
            records[1].node(&node.name).unwrap().outputs,
            "{}",
            node.name
        );
    }
    assert_eq!(fixture.take_ran(), 1 + 8, "each key is worked on once");
    let reduced = fixture.reduced.load(std::sync::atomic::Ordering::Relaxed);
    assert_eq!(reduced, 1, "and reduced once");
    assert_ne!(records[0].number, records[1].number);
}

#[test]
fn a_second_answer_for_one_key_is_told_and_the_first_stays() {
    let (dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let graph = TestPipeline::new(number).graph();
    // Another program stores its answer for `sum` while ours is at work.
    let (_dir2, elsewhere) = fresh_store();
    let (there, _) = run_on(&graph, &elsewhere);
    let key = there.node("sum").unwrap().key.unwrap();
    let mut record = elsewhere.record(&key).unwrap().unwrap();
    let path = dir.path().join(".marf");
    let first = Arc::new(parking_lot::Mutex::new(None));
    let kept = Arc::clone(&first);
    let meddle = move || {
        let other = Store::open(&path).unwrap();
        let digest = other.put(b"sum 41").unwrap();
        record
            .outputs
            .insert("sum".into(), marf_cache::Output { digest, bytes: 6 });
        let mut record = record.clone();
        record.metadata.program = "another".into();
        other.put_record(record);
        other.commit().unwrap();
        *kept.lock() = Some(digest);
    };
    let meddle = parking_lot::Mutex::new(meddle);
    *fixture.at_sum.lock() = Some(Arc::new(move || (meddle.lock())()));
    let (record, log) = run_on(&graph, &store);
    let told = warnings(&log);
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].contains("gave two results for key"), "{told:?}");
    let kept: Digest = first.lock().unwrap();
    assert_eq!(record.node("sum").unwrap().outputs["sum"].digest, kept);
    assert!(
        text(&store, &record, "many", "mean").starts_with("sum 41 0"),
        "below it the kept one is used"
    );
}

const KILL_DIR: &str = "MARF_TEST_KILL_DIR";

fn pipeline_of_forty(fixture: u64) -> TestPipeline {
    TestPipeline {
        b: 40,
        ..TestPipeline::new(fixture)
    }
}

/// Does nothing by itself. The next test starts it as a program of its own.
#[test]
fn the_program_that_is_killed() {
    let Ok(dir) = std::env::var(KILL_DIR) else {
        return;
    };
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    run_on(
        &pipeline_of_forty(number).graph(),
        &Store::open(Path::new(&dir)).unwrap(),
    );
}

#[test]
fn killed_again_and_again_it_loses_nothing_that_was_recorded() {
    let (_dir, store) = fresh_store();
    for wanted in [2, 10, 20] {
        let mut program = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "faults::the_program_that_is_killed"])
            .env(KILL_DIR, store.dir())
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        while store.stat().unwrap().records < wanted && program.try_wait().unwrap().is_none() {
            std::thread::yield_now();
        }
        program.kill().unwrap();
        program.wait().unwrap();
    }
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let recorded = store.records().unwrap();
    assert!(
        recorded
            .iter()
            .all(|record| store.hit(&record.key).unwrap().is_some()),
        "a record without its blob"
    );
    let members = recorded.iter().filter(|record| record.stage == "draw").count();
    let reopened = Store::open(store.dir()).unwrap();
    let (record, log) = run_on(&pipeline_of_forty(number).graph(), &reopened);
    assert_eq!(record.outcome, Outcome::Done, "{:?}", node_events(&log));
    assert_eq!(
        fixture.take_ran() as usize,
        40 - members,
        "{members} were recorded"
    );
    let (_dir2, other) = fresh_store();
    let (anew, _) = run_on(&pipeline_of_forty(number).graph(), &other);
    for node in &record.nodes {
        assert_eq!(
            node.outputs,
            anew.node(&node.name).unwrap().outputs,
            "{}",
            node.name
        );
    }
    let left = std::fs::read_dir(store.dir().join("tmp")).unwrap();
    let left = left
        .filter(|entry| entry.as_ref().unwrap().path().is_dir())
        .count();
    assert_eq!(left, 1, "only the folder of the store that is open stays");
}

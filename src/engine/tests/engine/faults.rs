//! Failures, stops, kills, damage, and several programs on one store.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Barrier},
};

use crate::common::*;
use marf_cache::{Digest, Store};
use marf_engine::{Cancel, Event, Graph, NodeState, Outcome, PlanState, RunRecord, last_run, plan};

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
    let planned = plan(&graph, &store, None, None).unwrap();
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

fn damage(path: &Path, wanted: &[u8]) {
    let mut bytes = std::fs::read(path).unwrap();
    let at = bytes
        .windows(wanted.len())
        .position(|window| window == wanted)
        .unwrap();
    bytes[at + wanted.len() - 1] ^= 4;
    std::fs::remove_file(path).unwrap();
    std::fs::write(path, bytes).unwrap();
}

/// The packs that hold a text.
fn packs_with(store: &Store, wanted: &[u8]) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(store.dir().join("packs")).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|ext| ext == "pack"));
    paths.retain(|path| {
        let bytes = std::fs::read(path).unwrap();
        bytes.windows(wanted.len()).any(|window| window == wanted)
    });
    paths
}

#[test]
fn a_damaged_output_is_made_again_and_the_stream_says_so() {
    let (dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let pipeline = TestPipeline::new(number);
    let (first, _) = run_on(&pipeline.graph(), &store);
    fixture.take_ran();
    let blob = b"\x06\0\0\0sum 20"; // its length, then its bytes
    damage(&packs_with(&store, blob)[0], blob);
    let store = Store::open(dir.path().join(".marf")).unwrap();
    // Nobody reads it: nothing is noticed yet. One more member reads it.
    let (record, log) = run_on(
        &TestPipeline {
            b: 4,
            ..pipeline.clone()
        }
        .graph(),
        &store,
    );
    assert_eq!(record.outcome, Outcome::Done, "{:?}", node_events(&log));
    let told = warnings(&log);
    let again = "is missing or damaged; `sum` will run again";
    assert!(told.iter().any(|warning| warning.ends_with(again)), "{told:?}");
    assert_eq!(ran(&log), vec!["many", "many/member-03", "sum"]);
    assert_eq!(
        record.node("sum").unwrap().outputs,
        first.node("sum").unwrap().outputs
    );
    assert_eq!(store.stat().unwrap().quarantined, 1);
    let (_, log) = run_on(&TestPipeline { b: 4, ..pipeline }.graph(), &store);
    assert_eq!(ran(&log), Vec::<String>::new());
}

#[test]
fn a_damaged_member_runs_again_when_it_is_read() {
    let (dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let pipeline = TestPipeline::new(number);
    run_on(&pipeline.graph(), &store);
    fixture.take_ran();
    let blob = b"\x08\0\0\0sum 20 2";
    damage(&packs_with(&store, blob)[0], blob);
    let store = Store::open(dir.path().join(".marf")).unwrap();
    let (record, log) = run_on(&TestPipeline { b: 4, ..pipeline }.graph(), &store);
    assert_eq!(record.outcome, Outcome::Done, "{:?}", node_events(&log));
    assert_eq!(ran(&log), vec!["many", "many/member-01", "many/member-03"]);
    assert_eq!(
        text(&store, &record, "many", "mean"),
        "sum 20 0\nsum 20 2\nsum 20 4\nsum 20 1\n"
    );
}

#[test]
fn a_damaged_photo_is_fetched_again() {
    let (dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    (1..=2).for_each(|shard| fixture.put_shard(shard));
    run_on(&TestPipeline::new(number).graph(), &store);
    fixture.take_fetched();
    damage(&packs_with(&store, b"image 12")[0], b"image 12");
    let store = Store::open(dir.path().join(".marf")).unwrap();
    let pipeline = TestPipeline {
        times: 2,
        ..TestPipeline::new(number)
    };
    let (record, log) = run_on(&pipeline.graph(), &store);
    assert_eq!(record.outcome, Outcome::Done, "{:?}", node_events(&log));
    assert_eq!(text(&store, &record, "sum", "sum"), "sum 84");
    assert_eq!(fixture.take_fetched(), vec![2], "only the shard that holds it");
}

/// Damages the stored bytes of an object, wherever they are.
fn damage_object(store: &Store, digest: &Digest) {
    let bytes = store.get(digest).unwrap();
    let len = (bytes.len() as u32).to_le_bytes();
    let entry = [digest.as_bytes(), len.as_slice(), &bytes].concat();
    for pack in packs_with(store, &entry) {
        damage(&pack, &entry);
    }
}

#[test]
fn two_damaged_photos_of_one_shard_heal_in_one_run() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    (1..=2).for_each(|shard| fixture.put_shard(shard));
    run_on(&TestPipeline::new(number).graph(), &store);
    for photo in ["image 8", "image 12"] {
        damage_object(&store, &Digest::of(photo.as_bytes()));
    }
    let pipeline = TestPipeline {
        times: 2,
        ..TestPipeline::new(number)
    };
    let (record, log) = run_on(&pipeline.graph(), &store);
    assert_eq!(record.outcome, Outcome::Done, "{:?}", node_events(&log));
    assert_eq!(text(&store, &record, "sum", "sum"), "sum 84");
}

/// The leaf of a step of a fold that nobody has read since.
#[test]
fn a_damaged_leaf_of_a_fold_is_made_again_by_that_step_alone() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    (1..=3).for_each(|shard| fixture.put_shard(shard));
    let (first, _) = run_on(&TestPipeline::new(number).graph(), &store);
    fixture.clear_log();
    let root = first.node("distinct").unwrap().outputs["photos"].digest;
    damage_object(&store, &set_of(&store, &root).leaves[1].leaf);
    let pipeline = TestPipeline {
        times: 2,
        ..TestPipeline::new(number)
    };
    let (record, log) = run_on(&pipeline.graph(), &store);
    assert_eq!(record.outcome, Outcome::Done, "{:?}", node_events(&log));
    assert!(ran(&log).contains(&"distinct".to_owned()));
    assert_eq!(
        record.node("distinct").unwrap().outputs,
        first.node("distinct").unwrap().outputs
    );
    assert_eq!((fixture.take_measured(), fixture.take_fetched()), (0, vec![]));
}

/// Every object that a finished run has stored: damaged one at a time, a run that needs it gives the result of an empty
/// store.
#[test]
fn whatever_object_is_damaged_the_run_that_reads_it_heals() {
    let (number, fixture) = new_fixture();
    (1..=2).for_each(|shard| fixture.put_shard(shard));
    let before = TestPipeline::new(number);
    let after = TestPipeline {
        times: 3,
        b: 4,
        most: 13,
        ..before.clone()
    };
    let (_dir, empty) = fresh_store();
    let (expected, _) = run_on(&after.graph(), &empty);
    let (_dir, store) = fresh_store();
    run_on(&before.graph(), &store);
    let objects = all_objects(&store);
    assert!(objects.len() > 50, "{}", objects.len());
    for digest in objects {
        let (_dir, store) = fresh_store();
        run_on(&before.graph(), &store);
        damage_object(&store, &digest);
        let (record, log) = run_on(&after.graph(), &store);
        assert_eq!(record.outcome, Outcome::Done, "{digest}: {:?}", node_events(&log));
        for node in &expected.nodes {
            let outputs = &record.node(&node.name).unwrap().outputs;
            assert_eq!(outputs, &node.outputs, "{digest} of {}", node.name);
        }
    }
}

/// Returns the digests of everything that the records of a store name.
fn all_objects(store: &Store) -> Vec<Digest> {
    let mut objects = std::collections::BTreeSet::new();
    for record in store.records().unwrap() {
        objects.insert(record.key);
        objects.extend(record.outputs.values().map(|output| output.digest));
        if let Some(needs) = record.needs {
            objects.insert(needs);
            objects.extend(marf_cache::read_digest_list(&store.get(&needs).unwrap()).unwrap());
        }
        objects.extend(record.parts);
    }
    objects.into_iter().collect()
}

#[test]
fn an_unreadable_run_costs_a_warning() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let graph = TestPipeline::new(number).graph();
    run_on(&graph, &store);
    run_on(&graph, &store);
    let newest = run_files(&store).pop().unwrap();
    std::fs::remove_file(&newest).unwrap();
    std::fs::write(&newest, b"{").unwrap();
    let (record, log) = run_on(&graph, &store);
    assert_eq!(ran(&log), Vec::<String>::new());
    assert_eq!(record.number, 3);
    let told = warnings(&log);
    assert!(
        told.len() == 1 && told[0].starts_with("run 2 cannot be read"),
        "{told:?}"
    );
}

/// The files of all runs, sorted.
fn run_files(store: &Store) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(store.dir().join("runs")).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths
}

#[test]
fn what_a_lost_pack_held_is_made_again() {
    let (dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    let graph = TestPipeline::new(number).graph();
    let (first, _) = run_on(&graph, &store);
    for pack in packs_with(&store, b"sum 20 0\nsum 20") {
        std::fs::remove_file(pack).unwrap();
    }
    drop(store);
    let store = Store::open(dir.path().join(".marf")).unwrap();
    let last = last_run(&store, "test", no_warning).unwrap();
    let planned = plan(&graph, &store, last.as_ref(), None).unwrap();
    let many = planned.iter().find(|node| node.node == "many").unwrap();
    assert_eq!(many.state, PlanState::WillRun, "{}", many.reason);
    let (record, _) = run_on(&graph, &store);
    assert_eq!(record.outcome, Outcome::Done);
    let mean = |record: &RunRecord| record.node("many").unwrap().outputs["mean"];
    assert_eq!(mean(&record), mean(&first));
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

/// Does nothing by itself; the next test starts it as a program of its own.
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

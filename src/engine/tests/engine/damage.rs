//! Damaged and lost objects of the store: the run that meets one heals it.

use std::path::PathBuf;

use crate::common::*;
use marf_cache::{Digest, Store};
use marf_engine::{Outcome, PlanOptions, PlanState, RunRecord, RunSource, last_run, plan};

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
    let again = "is missing or damaged: `sum` will run again";
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

#[test]
fn two_damaged_photos_of_one_shard_heal_in_one_run() {
    let (_dir, store) = fresh_store();
    let (number, fixture) = new_fixture();
    (1..=2).for_each(|shard| fixture.put_shard(shard));
    run_on(&TestPipeline::new(number).graph(), &store);
    for photo in ["image 8", "image 12"] {
        damage_object(&store, &Digest::from_content(photo.as_bytes()));
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
    let objects = damage_each_object(&before.graph(), &after.graph());
    assert!(objects > 50, "{objects}");
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
    let last = last_run(&store, "test", &RunSource::default(), no_warning).unwrap();
    let planned = plan(&graph, &store, last.as_ref(), &PlanOptions::default()).unwrap();
    let many = planned.iter().find(|node| node.node == "many").unwrap();
    assert_eq!(many.state, PlanState::WillRun, "{}", many.reason);
    let (record, _) = run_on(&graph, &store);
    assert_eq!(record.outcome, Outcome::Done);
    let mean = |record: &RunRecord| record.node("many").unwrap().outputs["mean"];
    assert_eq!(mean(&record), mean(&first));
}

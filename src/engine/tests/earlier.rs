//! A node that sees its own last output: it goes on from there, and never runs on its own output alone.

#![allow(clippy::unwrap_used, reason = "a test that is set up wrong should stop")]

mod common;

use common::*;
use marf_cache::Store;
use marf_engine::{Graph, NodeState, Outcome, PlanState, RunRecord, last_run, plan, why};

/// The archive, its sum times a number, and a diary of the sums.
struct Book {
    world: u64,
    times: u64,
    extend: bool,
}

impl Book {
    fn graph(&self) -> Graph {
        let json = |key: &str, value: serde_json::Value| serde_json::json!({ key: value });
        let nodes = vec![
            node("archive", "archive", self.world, serde_json::json!({}), &[]),
            node(
                "sum",
                "sum",
                self.world,
                json("times", self.times.into()),
                &["input=archive"],
            ),
            node(
                "diary",
                "diary",
                self.world,
                json("extend", self.extend.into()),
                &["input=sum"],
            ),
        ];
        Graph::new(nodes, TABLE).unwrap()
    }

    /// Plans and runs; the two must agree on the diary, its key and whether it runs.
    fn run(&self, store: &Store) -> (RunRecord, NodeState, Ears) {
        let last = last_run(store, "test").unwrap();
        let planned = plan(&self.graph(), store, last.as_ref()).unwrap().remove(2);
        let (record, ears) = run_on(&self.graph(), store);
        assert_eq!(record.outcome, Outcome::Done, "{:?}", happened(&ears));
        let node = record.node("diary").unwrap();
        let state = node.state;
        assert_eq!(
            planned.state == PlanState::WillRun,
            state == NodeState::Finished,
            "{planned:?}"
        );
        assert!(planned.key.is_none_or(|key| Some(key) == node.key), "{planned:?}");
        (record, state, ears)
    }
}

/// A store, and a book whose first page says `sum 45`.
fn begun() -> (tempfile::TempDir, Store, Book) {
    let (dir, store) = fresh_store();
    let (world, archive) = new_world();
    archive.put_shard(1);
    let book = Book {
        world,
        times: 1,
        extend: true,
    };
    let (record, state, ears) = book.run(&store);
    assert_eq!(
        (state, reason_of(&ears, "diary").unwrap().as_str()),
        (NodeState::Finished, "never ran")
    );
    assert_eq!(text(&store, &record, "diary", "diary"), "sum 45\n");
    (dir, store, book)
}

#[test]
fn what_changed_is_added_to_the_last_output_and_without_a_change_nothing_runs() {
    let (_dir, store, mut book) = begun();
    assert_eq!(book.run(&store).1, NodeState::Reused);
    book.times = 2;
    let (record, state, ears) = book.run(&store);
    assert_eq!(state, NodeState::Finished);
    assert_eq!(text(&store, &record, "diary", "diary"), "sum 45\nsum 90\n");
    assert_eq!(reason_of(&ears, "diary").unwrap(), "input sum changed");
    for _ in 0..3 {
        let (again, state, _) = book.run(&store);
        assert_eq!(
            (state, again.node("diary").unwrap().key),
            (NodeState::Reused, record.node("diary").unwrap().key)
        );
    }
    book.times = 1;
    let (record, _, _) = book.run(&store);
    assert_eq!(
        text(&store, &record, "diary", "diary"),
        "sum 45\nsum 90\nsum 45\n"
    );
    assert_eq!(book.run(&store).1, NodeState::Reused);
}

#[test]
fn the_earlier_output_stands_in_the_key_and_among_the_changes() {
    let (_dir, store, mut book) = begun();
    let first = last_run(&store, "test").unwrap().unwrap();
    book.times = 2;
    book.run(&store);
    let key = last_run(&store, "test").unwrap().unwrap().latest["diary"];
    let manifest = store.record(&key).unwrap().unwrap().manifest;
    let page = first.node("diary").unwrap().outputs["diary"].digest;
    assert!(
        manifest.contains(&format!("inputs.earlier = {page}\n")),
        "{manifest}"
    );

    book.times = 3;
    run_with(
        &book.graph(),
        &store,
        &only("sum"),
        &marf_engine::Cancel::default(),
    );
    let last = last_run(&store, "test").unwrap();
    let planned = why(&book.graph(), &store, last.as_ref(), "diary").unwrap();
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
    let (_dir, store, mut book) = begun();
    (book.extend, book.times) = (false, 2);
    let (record, _, _) = book.run(&store);
    assert_eq!(text(&store, &record, "diary", "diary"), "sum 90\n");
    book.extend = true;
    let (record, _, ears) = book.run(&store);
    assert_eq!(reason_of(&ears, "diary").unwrap(), "params.extend: false -> true");
    assert_eq!(text(&store, &record, "diary", "diary"), "sum 90\nsum 90\n");
    assert_eq!(book.run(&store).1, NodeState::Reused);
}

#[test]
fn an_earlier_output_that_is_damaged_is_none() {
    let (dir, store, mut book) = begun();
    drop(store);
    for entry in std::fs::read_dir(dir.path().join(".marf/packs")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|end| end == "pack") {
            let mut bytes = std::fs::read(&path).unwrap();
            let page = bytes.windows(7).position(|part| part == b"sum 45\n");
            page.into_iter().for_each(|at| bytes[at + 5] = b'4');
            std::fs::write(&path, bytes).unwrap();
        }
    }
    let store = Store::open(dir.path().join(".marf")).unwrap();
    book.times = 2;
    let (record, _) = run_on(&book.graph(), &store);
    assert_eq!(record.outcome, Outcome::Done);
    assert_eq!(text(&store, &record, "diary", "diary"), "sum 90\n");
}

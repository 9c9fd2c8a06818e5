//! `marf replay`: equal, different, not made here.

use std::path::Path;

use marf_cache::{Action, Record, Store};
use marf_engine::action_at;
use serde_json::Value;

use super::common::marf;
use super::{PIPELINE, ran};

#[test]
fn a_replay_from_the_pinned_bytes_gives_the_same_digests_on_any_number_of_threads() {
    let dir = ran();
    for threads in ["1", "2"] {
        let told = marf(dir.path(), &["replay", "--threads", threads, "--json"]).exits(0);
        let told: Value = serde_json::from_str(&told.stdout).unwrap();
        let nodes = told["nodes"].as_array().unwrap();
        assert_eq!(nodes.len(), 4, "{told}");
        for node in nodes {
            assert!(
                node["equal"].as_u64().unwrap() > 0 && node["not_made"].is_null(),
                "{node}"
            );
            assert_eq!(node["differs"], serde_json::json!([]), "{node}");
        }
    }
    let told = marf(dir.path(), &["replay", "out/calibrate/points.ply"]);
    let code = if dir.path().join("out/calibrate/points.ply").exists() {
        0
    } else {
        2
    };
    assert_eq!(told.code, code, "{}", told.stderr);
    let one = marf(dir.path(), &["replay", "blur"]).exits(0).stdout;
    assert_eq!(
        one.lines().next().unwrap(),
        "`blur` of run 1 and all that leads to it gave the same bytes when repeated: all 5 results of 2 nodes are equal."
    );
    let whole = marf(dir.path(), &["replay"]).exits(0).stdout;
    let first = whole.lines().next().unwrap();
    assert!(
        first.starts_with("Run 1 gave the same bytes when repeated: all "),
        "{first}"
    );
    assert!(first.ends_with(" results of 4 nodes are equal."), "{first}");
    marf(dir.path(), &["replay", "nothing"]).exits(2);
    marf(dir.path(), &["replay", "99"]).exits(1);
}

/// A training by the clock has other steps each time. The schedule that it ran then repeats its bytes.
#[test]
fn a_training_with_a_budget_is_replayed_by_the_schedule_that_it_ran() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(
        dir.path().join("pipeline.toml"),
        PIPELINE.replace("steps = 2", "budget = \"1s\""),
    )
    .unwrap();
    marf(dir.path(), &["run"]).exits(0);
    let told = marf(dir.path(), &["replay", "train"]).exits(0).stdout;
    assert!(told.contains(" results of 4 nodes are equal."), "{told}");
}

/// Writes a run into a store that differs from the last one in what a node ran on: a GPU that no machine has.
fn claim_a_gpu(folder: &Path, name: &str) {
    let store = Store::open(folder.join(".marf")).unwrap();
    let mut run = marf_engine::runs(&store, |_| {}).unwrap().pop().unwrap();
    let node = run.nodes.iter_mut().find(|node| node.name == name).unwrap();
    let was = node.key.unwrap();
    let action = Action {
        backend: Some("GPU of nobody".to_owned()),
        ..action_at(&store, &was).unwrap().unwrap()
    };
    let key = store.put(&action.encode()).unwrap();
    let record = store.record(&was).unwrap().unwrap();
    store.put_record(Record { key, ..record });
    node.key = Some(key);
    run.store(&store, |_| {}).unwrap();
}

/// What ran on a GPU that is not here is neither equal nor different.
#[test]
fn a_node_that_cannot_be_made_here_has_an_answer_of_its_own() {
    let dir = ran();
    claim_a_gpu(dir.path(), "calibrate");
    let told = marf(dir.path(), &["replay", "--json"]).exits(9);
    assert!(
        told.stderr.contains("a part of run 2 could not be repeated here"),
        "{}",
        told.stderr
    );
    let told: Value = serde_json::from_str(&told.stdout).unwrap();
    let nodes = told["nodes"].as_array().unwrap();
    let words: Vec<&str> = nodes
        .iter()
        .map(|node| node["not_made"].as_str().unwrap_or("made"))
        .collect();
    let needs = "it needs `calibrate`, which is not made here";
    let foreign = "it ran on GPU of nobody, which is not here";
    assert_eq!(words, ["made", "made", foreign, needs]);
    // The nodes before it can be made, but the requested node decides.
    marf(dir.path(), &["replay", "blur"]).exits(0);
    let told = marf(dir.path(), &["replay", "train"]).exits(9).stdout;
    assert_eq!(
        told.lines().next().unwrap(),
        "`train` of run 2 and all that leads to it could not be repeated in full here: 2 of 4 nodes, first `calibrate`. What was repeated \
         gave the same bytes: 5 results of 2 nodes."
    );
}

/// A run whose first node failed has nothing to compare with.
#[test]
fn a_replay_of_a_run_without_results_is_not_a_success() {
    let dir = tempfile::tempdir().unwrap();
    let pipeline = "name = \"absent\"\n[archive.mine]\nkind = \"folder\"\npath = \"photos\"\n[node.extract]\narchive = \"mine\"\n";
    std::fs::write(dir.path().join("pipeline.toml"), pipeline).unwrap();
    marf(dir.path(), &["run"]).exits(1);
    let replayed = marf(dir.path(), &["replay", "1"]).exits(12);
    assert_eq!(
        replayed.stdout.lines().next().unwrap(),
        "Nothing was compared: run 1 has no result that can be repeated."
    );
    assert!(
        replayed.stderr.contains("run 1 has no result to compare with")
            && replayed
                .stderr
                .contains("`marf log` lists all runs. Name one with results"),
        "{}",
        replayed.stderr
    );
}

/// A run whose root names other bytes than its stages give.
#[test]
fn a_replay_that_differs_says_what_and_where() {
    let dir = ran();
    let store = Store::open(dir.path().join(".marf")).unwrap();
    let mut run = marf_engine::runs(&store, |_| {}).unwrap().pop().unwrap();
    let other = store.put(b"{}").unwrap();
    let node = run.nodes.iter_mut().find(|node| node.name == "train").unwrap();
    let output = node.outputs.get_mut("weights").unwrap();
    (output.digest, output.bytes) = (other, 2);
    run.store(&store, |_| {}).unwrap();
    drop(store);
    let told = marf(dir.path(), &["replay", "2"]).exits(7);
    let first = told.stdout.lines().next().unwrap();
    assert!(
        first.starts_with("Run 2 did not give the same bytes when repeated: 1 of "),
        "{first}"
    );
    assert!(
        first.ends_with(" results of 4 nodes differ, first in `train`."),
        "{first}"
    );
    assert!(
        told.stderr.contains("error: a result of run 2 is different"),
        "{}",
        told.stderr
    );
    let weights = std::fs::read(dir.path().join("out/train/weights.safetensors")).unwrap();
    let first_byte = b"{}".iter().zip(&weights).position(|(a, b)| a != b).unwrap();
    let same = b"{}".iter().zip(&weights).filter(|(a, b)| a == b).count();
    let size = marf_progress::format::size;
    let line = format!(
        ", from byte {first_byte} on, {} of 2 bytes ({} now)",
        marf_progress::format::count(weights.len() - same, "byte"),
        size(weights.len() as u64)
    );
    assert!(told.stdout.contains(&line), "{line}: {}", told.stdout);
    assert!(told.stdout.contains("different, 1 of "), "{}", told.stdout);
    let json = marf(dir.path(), &["replay", "2", "--json"]).exits(7).stdout;
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["answer"], "differs");
}

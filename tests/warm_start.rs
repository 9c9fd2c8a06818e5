//! A scene that grows by a sol: the cameras of before stay, and the training goes on from the field of before.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod common;

use std::collections::BTreeMap;
use std::path::Path;

use common::{Ran, marf, ran};
use serde_json::Value;

const PIPELINE: &str = r#"name = "grow"
[archive.demo]
kind = "demo"
sols = "1"
width = 160
[node.extract]
archive = "demo"
[node.calibrate]
input = "extract"
extend = true
[node.train]
input = "calibrate"
steps = 24
scale = 4
device = "cpu"
warm_start = true
"#;

/// A folder in which [`PIPELINE`] has run. The next run is of another pipeline.
fn written(pipeline: &str) -> tempfile::TempDir {
    let dir = ran("grow", PIPELINE);
    std::fs::write(dir.path().join("pipeline.toml"), pipeline).unwrap();
    dir
}

fn run(folder: &Path, more: &[&str]) -> Ran {
    marf(folder, &[&["run", "--json"], more].concat()).exits(0)
}

const WIDER: [&str; 2] = ["--set", "archive.demo.sols=1..=2"];

fn document(folder: &Path, name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("out/train").join(name)).unwrap()).unwrap()
}

/// Which photos of the scene are held out, by id.
fn held_out(folder: &Path) -> BTreeMap<String, bool> {
    let scene = document(folder, "scene.json");
    let frames = scene["frames"].as_array().unwrap().iter();
    let flag = |frame: &Value| {
        (
            frame["id"].as_str().unwrap().to_owned(),
            frame["held_out"] == true,
        )
    };
    frames.map(flag).collect()
}

/// The inputs of the last training.
fn earlier(folder: &Path) -> Value {
    let status = marf(folder, &["status", "--json"]).exits(0).stdout;
    let status: Value = serde_json::from_str(&status).unwrap();
    let mut nodes = status["nodes"].as_array().unwrap().iter();
    let train = nodes.find(|node| node["name"] == "train").unwrap();
    train["inputs"]["earlier"]["digest"].clone()
}

fn weights(folder: &Path) -> String {
    let bytes = std::fs::read(folder.join("out/train/weights.safetensors")).unwrap();
    marf_cache::Digest::from_content(&bytes).to_string()
}

fn grown(pipeline: &str) -> (tempfile::TempDir, String) {
    let dir = written(pipeline);
    run(dir.path(), &[]);
    let first = weights(dir.path());
    run(dir.path(), &WIDER);
    (dir, first)
}

#[test]
fn a_new_sol_goes_on_from_the_last_field_and_the_record_says_so() {
    let dir = written(PIPELINE);
    let (first, before) = (weights(dir.path()), held_out(dir.path()));
    let cold = serde_json::json!({"cold": "this node has not finished before"});
    assert_eq!(document(dir.path(), "metrics.json")["warm_start"], cold);
    assert_eq!(run(dir.path(), &[]).nodes("will_run"), [] as [&str; 0]);

    let ran = run(dir.path(), &WIDER);
    assert_eq!(ran.nodes("warning"), [] as [&str; 0], "{}", ran.stdout);
    let from = serde_json::json!({"from": first});
    for name in ["metrics.json", "setup.json"] {
        assert_eq!(document(dir.path(), name)["warm_start"], from, "{name}");
    }
    assert_eq!(earlier(dir.path()), first.as_str());
    let after = held_out(dir.path());
    assert!(
        after.len() > before.len() && before.values().any(|is| *is),
        "{} {}",
        before.len(),
        after.len()
    );
    for (id, was) in &before {
        assert_eq!(after.get(id), Some(was), "{id}");
    }
    // Its own output alone makes nothing run.
    for _ in 0..2 {
        assert_eq!(run(dir.path(), &WIDER).nodes("will_run"), [] as [&str; 0]);
    }

    let told = marf(dir.path(), &["replay", "train"]).exits(0).stdout;
    assert!(told.contains("gave the same bytes when repeated"), "{told}");
    let audited = marf(dir.path(), &["audit", "--all", "out/train/weights.safetensors"])
        .exits(0)
        .stdout;
    assert!(audited.contains("earlier"), "{audited}");
}

/// The schedule that it ran, from the field that it started from, repeats a training by the clock.
#[test]
fn one_with_a_budget_is_replayed_from_the_field_that_it_started_from() {
    let (dir, first) = grown(&PIPELINE.replace("steps = 24", "budget = \"1s\""));
    let told = document(dir.path(), "metrics.json");
    assert_eq!(told["warm_start"]["from"], first.as_str());
    let told = marf(dir.path(), &["replay", "train"]).exits(0).stdout;
    assert!(told.contains("gave the same bytes when repeated"), "{told}");
}

#[test]
fn a_cold_start_is_warned_of_and_what_cannot_be_is_refused_before_anything_runs() {
    let dir = written(PIPELINE);
    let sets = [&WIDER[..], &["--set", "train.field.density_width=16"]].concat();
    let ran = run(dir.path(), &sets);
    let said = document(dir.path(), "metrics.json")["warm_start"]["cold"].clone();
    let said = said.as_str().unwrap();
    assert!(said.contains("`field.density_width` is 16 and was 32"), "{said}");
    let warnings: Vec<Value> = ran
        .events()
        .into_iter()
        .filter(|event| event["event"] == "warning")
        .collect();
    assert!(
        warnings
            .iter()
            .any(|one| one["node"] == "train" && one["message"].as_str().unwrap().contains(said)),
        "{warnings:?}"
    );

    let refused = |pipeline: String, words: [&str; 2]| {
        std::fs::write(dir.path().join("pipeline.toml"), pipeline).unwrap();
        let told = marf(dir.path(), &["plan"]).exits(2).stderr;
        assert!(words.iter().all(|word| told.contains(word)), "{told}");
    };
    let resample = format!("{PIPELINE}resample = 3\n");
    refused(resample, ["train.warm_start", "`resample` is given too"]);
    let of = "training = \"other\"\n[node.other]\nuses = \"train\"\ninput = \"calibrate\"\n";
    let of = PIPELINE.replace("steps = 24\nscale = 4\n", "") + of;
    refused(of, ["train.warm_start", "`training` sets it too"]);
    let from = "from = \"half\"\n[node.half]\nuses = \"partial\"\ninput = \"calibrate\"\nuntil = 16\n";
    let from = format!("{PIPELINE}{from}");
    refused(from, ["train.warm_start", "`from` sets it too"]);
    std::fs::write(dir.path().join("pipeline.toml"), PIPELINE).unwrap();
    let told = marf(dir.path(), &["trade"]).exits(2).stderr;
    assert!(told.contains("--set train.warm_start=false"), "{told}");
}

/// The first training is a cold one, whose seeds a bootstrap repeats. The next is not, and the bootstrap alone fails.
#[test]
fn a_bootstrap_of_it_fails_with_the_way_out() {
    let bootstrap = "[node.bootstrap]\ninput = \"calibrate\"\ntraining = \"train\"\nb = 2\nmap_frames = 1\n";
    let dir = written(&format!("{PIPELINE}{bootstrap}"));
    run(dir.path(), &[]);
    let ran = marf(dir.path(), &[&["run"][..], &WIDER].concat()).exits(1);
    let told = ran.stderr;
    assert!(
        told.contains("bootstrap: the training that `training` names started from an earlier field"),
        "{told}"
    );
    assert!(told.contains("set `warm_start = false`"), "{told}");
    assert!(document(dir.path(), "metrics.json")["warm_start"]["from"].is_string());
}

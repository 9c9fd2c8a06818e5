//! The whole pipeline on the built-in Mars, small: which nodes run when, and the same bytes for any threads.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod common;

use std::collections::BTreeMap;
use std::path::Path;

use common::{Ran, SMALL_DEMO, marf};

fn run(folder: &Path, more: &[&str]) -> Ran {
    let mut args = vec!["run", "--json"];
    args.extend(SMALL_DEMO.iter().flat_map(|set| ["--set", set]));
    args.extend(more);
    marf(folder, &args).exits(0)
}

fn demo() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    marf(dir.path(), &["init"]).exits(0);
    dir
}

/// Digests of all outputs of the last run, by node and name.
fn digests(folder: &Path) -> BTreeMap<String, String> {
    let status: serde_json::Value =
        serde_json::from_str(&marf(folder, &["status", "--json"]).exits(0).stdout).unwrap();
    let mut found = BTreeMap::new();
    for node in status["nodes"].as_array().unwrap() {
        for (name, output) in node["outputs"].as_object().unwrap() {
            let key = format!("{} {name}", node["name"].as_str().unwrap());
            found.insert(key, output["digest"].as_str().unwrap().to_owned());
        }
    }
    found
}

fn count(ran: &Ran, node: &str, what: &str) -> u64 {
    let events = ran.events();
    let finished = events
        .iter()
        .find(|event| event["event"] == "finished" && event["node"] == node);
    finished.unwrap_or_else(|| panic!("{node} did not run"))["counts"][what]
        .as_u64()
        .unwrap_or(0)
}

#[test]
fn only_what_changed_runs_again() {
    let dir = demo();
    let first = run(dir.path(), &[]);
    assert_eq!(first.nodes("failed"), Vec::<String>::new());
    let kept = count(&first, "blur", "photos");
    assert!((30..=44).contains(&kept), "{kept} photos kept of two sols");
    let report = std::fs::read_to_string(dir.path().join("out/report.html")).unwrap();
    assert!(
        report.contains("bootstrap") && report.len() > 100_000,
        "{} bytes of report",
        report.len()
    );
    for file in [
        "train/weights.safetensors",
        "calibrate/transforms.json",
        "video/video.mp4",
        "uncertainty/video.mp4",
    ] {
        assert!(dir.path().join("out").join(file).exists(), "{file}");
    }

    let again = run(dir.path(), &[]);
    assert_eq!(again.nodes("finished"), Vec::<String>::new(), "nothing changed");

    let threshold = run(dir.path(), &["--set", "blur.min_share=0.51"]);
    assert_eq!(
        threshold.nodes("finished"),
        ["blur"],
        "same photos kept: nothing downstream runs"
    );
    assert_eq!(
        count(&threshold, "blur", "measured"),
        0,
        "a threshold decodes no photo"
    );

    let more = run(dir.path(), &["--set", "bootstrap.b=5"]);
    let mut ran = more.nodes("finished");
    ran.sort(); // members run side by side: either may end first
    let changed = [
        "bootstrap",
        "bootstrap/member-03",
        "bootstrap/member-04",
        "uncertainty",
    ];
    assert_eq!(ran, changed);

    let coarser = run(
        dir.path(),
        &["--set", "bootstrap.b=5", "--set", "video.quantizer=40"],
    );
    assert_eq!(
        coarser.nodes("finished"),
        ["video"],
        "another quality renders nothing"
    );

    let sol = run(dir.path(), &["--set", "archive.demo.sols=1..=3", "--to", "blur"]);
    assert_eq!(
        count(&sol, "extract", "fetched"),
        1,
        "only the new sol is fetched"
    );
    let new = count(&sol, "extract", "photos") - count(&first, "extract", "photos");
    assert_eq!(
        count(&sol, "extract", "measured"),
        new,
        "only the new photos are measured"
    );

    let plan = marf(dir.path(), &["plan", "--json", "--set", "train.steps=13"]).exits(0);
    let rows: Vec<serde_json::Value> = serde_json::from_str(&plan.stdout).unwrap();
    let train = rows.iter().find(|row| row["node"] == "train").unwrap();
    assert_eq!(train["state"], "will_run");
}

#[test]
fn one_and_two_threads_give_the_same_digests() {
    let (one, two) = (demo(), demo());
    run(one.path(), &["--threads", "1", "--set", "archive.demo.sols=1"]);
    run(two.path(), &["--threads", "2", "--set", "archive.demo.sols=1"]);
    let (one, two) = (digests(one.path()), digests(two.path()));
    assert!(one.len() > 40, "{} outputs", one.len());
    assert_eq!(one, two);
}

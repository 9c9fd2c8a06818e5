//! A run is followed while it goes on.

use std::io::{BufRead as _, BufReader};
use std::process::{Command, Stdio};

use super::common::marf;
use super::{Viewer, http};

/// Extraction and a filter on a sol of the built-in Mars.
const SMALL: &str = "name = \"small\"\n[archive.demo]\nkind = \"demo\"\nsols = \"1\"\nwidth = 160\n\
    [node.extract]\narchive = \"demo\"\n[node.size]\ninput = \"extract\"\nmin_bytes = 2_000\n";

#[test]
fn a_page_is_told_of_a_run_from_its_beginning_to_the_report() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("pipeline.toml"), SMALL).unwrap();
    std::fs::create_dir(dir.path().join(".marf")).unwrap();
    let viewer = Viewer::start(dir.path(), &[]);
    let page = viewer.get("/").is(200).text();
    assert!(
        page.contains("No run of this store has ended with a report or a field yet"),
        "{page}"
    );
    let stream = http::send(&viewer.authority, "GET", "/events", &[], b"");
    let mut lines = BufReader::new(stream).lines().map(Result::unwrap);
    let mut next = |wanted: &str| lines.find(|line| line.contains(wanted)).unwrap();
    next("event: idle");
    let mut run = Command::new(env!("CARGO_BIN_EXE_marf"))
        .current_dir(dir.path())
        .args(["run"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let began = next("\"event\":\"began\"");
    assert!(began.contains("\"nodes\":[\"extract\",\"size\"]"), "{began}");
    next("\"event\":\"will_run\",\"node\":\"extract\"");
    next("\"event\":\"finished\",\"node\":\"size\"");
    next("event: newest");
    assert_eq!(next("data: "), "data: 1");
    assert!(run.wait().unwrap().success());
    assert!(viewer.get("/").is(200).text().contains("<h1>small</h1>"));
    let left = std::fs::read_dir(dir.path().join(".marf/scratch/events")).unwrap();
    assert_eq!(left.count(), 0, "a run that ended leaves no events");
    // The store has no key more: a second run has nothing to do.
    assert!(
        marf(dir.path(), &["run"])
            .exits(0)
            .stdout
            .contains("0 of 2 nodes ran")
    );
}

//! Measures of photos as tasks of an array.

use super::{Site, outputs};
use crate::common::marf;

const FILTERED: &str = r#"name = "cluster"
[archive.demo]
kind = "demo"
sols = "1..=4"
width = 64
[node.extract]
archive = "demo"
[node.duplicate]
input = "extract"
[node.blur]
input = "duplicate"
"#;

/// A machine that has pulled a run has no measures. It has them made by tasks of an array, some of which are killed. The result is that of a run
/// that measures itself, and nothing is measured twice.
#[test]
fn measures_of_photos_are_tasks_of_an_array_and_give_the_digests_of_a_local_run() {
    let local = tempfile::tempdir().unwrap();
    std::fs::write(local.path().join("pipeline.toml"), FILTERED).unwrap();
    let site = Site::new(FILTERED);
    let store = format!("file://{}", site.path().join("shared").display());
    marf(local.path(), &["run", "--to", "extract"]).exits(0);
    marf(local.path(), &["cache", "push", "--remote", &store]).exits(0);
    marf(local.path(), &["run"]).exits(0);

    std::fs::remove_dir_all(site.path().join(".marf")).unwrap();
    marf(site.path(), &["cache", "pull", "--remote", &store]).exits(0);
    let text = std::fs::read_to_string(site.path().join("site.toml")).unwrap();
    let text = text.replace("cores = 1\n", "cores = 1\nphotos_per_task = 1\nmax_array = 3\n");
    std::fs::write(site.path().join("site.toml"), text).unwrap();
    site.tell("kill_tasks", "1");
    let ran = site.run(&[]).exits(0);
    // Four shards in arrays of three tasks and of one, and the killed one. One look at a photo measures it for both filters.
    assert_eq!(
        site.noted("arrays"),
        ["101 3", "102 1", "103 1"],
        "{}",
        ran.stderr
    );
    assert!(
        ran.stderr.contains("1 task ended without a result"),
        "{}",
        ran.stderr
    );
    assert_eq!(outputs(site.path()), outputs(local.path()));
    let left: Vec<_> = std::fs::read_dir(site.path().join("jobs")).unwrap().collect();
    assert!(left.is_empty(), "{left:?}");

    // Thresholds change no measure.
    let stricter = FILTERED.to_owned() + "min_ratio = 0.9\n";
    std::fs::write(site.path().join("pipeline.toml"), stricter).unwrap();
    let again = site.run(&[]).exits(0);
    assert!(again.stdout.contains("1 of 3 nodes ran"), "{}", again.stdout);
    assert_eq!(site.noted("arrays").len(), 3, "{}", again.stderr);
}

//! Measures of photos as jobs.

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

/// A machine that has pulled a run has no measures. It has them made by jobs, each of which is killed once. The result is that of a run
/// that measures itself, and nothing is measured twice.
#[test]
fn measures_of_photos_are_jobs_and_give_the_digests_of_a_local_run() {
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
    let text = text.replace("cores = 1\n", "cores = 1\nphotos_per_task = 1\nmax_jobs = 3\n");
    std::fs::write(site.path().join("site.toml"), text).unwrap();
    site.tell("kills", "1");
    let ran = site.run(&[]).exits(0);
    // Four shards, each killed once. One look at a photo measures it for both filters.
    assert_eq!(site.noted("history").len(), 8, "{}", ran.stderr);
    assert!(
        ran.stderr.contains(") and is submitted with 1.4 GB"),
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
    assert_eq!(site.noted("history").len(), 8, "{}", again.stderr);
}

//! Every action of a run computed again by `marf exec`.

use std::collections::BTreeSet;

use serde_json::Value;

use super::{PIPELINE, Site};
use crate::common::marf;

/// Filters of the demo, of every kind of work that has parts.
const FILTERS: &str = r#"name = "filters"
[archive.demo]
kind = "demo"
sols = "1..=2"
width = 64
[node.extract]
archive = "demo"
[node.grayscale]
input = "extract"
[node.duplicate]
input = "grayscale"
[node.histogram]
input = "duplicate"
"#;

/// Every node of a run, from an empty folder and the shared store alone, gives the result of the run. One that reads an archive and a part
/// of a node are refused with a code of their own.
#[test]
fn every_filter_is_computed_again_from_the_shared_store_alone() {
    let parts = computed_again(&Site::new(FILTERS));
    assert!(
        parts.contains("fold") && parts.contains("summarise") && parts.contains("decide"),
        "{parts:?}"
    );
}

/// A user may give any folder: `.` holds other files, and one that holds none is made and removed.
#[test]
fn the_scratch_folder_loses_nothing_but_what_the_job_put_there() {
    let site = Site::new(FILTERS);
    marf(site.path(), &["run"]).exits(0);
    let store = format!("file://{}", site.path().join("shared").display());
    marf(site.path(), &["cache", "push", "--remote", &store]).exits(0);
    let status = marf(site.path(), &["status", "--json"]).exits(0).stdout;
    let status: Value = serde_json::from_str(&status).unwrap();
    let nodes = status["nodes"].as_array().unwrap();
    let node = nodes.iter().find(|node| node["name"] == "grayscale").unwrap();
    let key = node["key"].as_str().unwrap();
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("notes.txt"), "mine").unwrap();
    for scratch in [".", "made"] {
        marf(
            folder.path(),
            &["exec", key, "--store", &store, "--scratch", scratch],
        )
        .exits(0);
        let left = std::fs::read_dir(folder.path()).unwrap();
        let left: Vec<_> = left.map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!(left, ["notes.txt"], "--scratch {scratch}");
    }
}

/// As above, for a training and its bootstrap. An action of another version is refused with that code, too.
#[test]
fn every_training_is_computed_again_from_the_shared_store_alone() {
    let site = Site::new(PIPELINE);
    computed_again(&site);

    let store = format!("file://{}", site.path().join("shared").display());
    let status = marf(site.path(), &["status", "--json"]).exits(0).stdout;
    let status: Value = serde_json::from_str(&status).unwrap();
    let nodes = status["nodes"].as_array().unwrap();
    let train = nodes.iter().find(|node| node["name"] == "train").unwrap();
    let key: marf_cache::Digest = train["key"].as_str().unwrap().parse().unwrap();
    let own = marf_cache::Store::open(site.path().join(".marf")).unwrap();
    let mut action = marf_cache::Action::decode(&own.get(&key).unwrap()).unwrap();
    action.version += 1;
    let file = site.path().join("newer.action");
    // jq and editors end a file with a newline.
    std::fs::write(&file, [action.encode(), b"\n".to_vec()].concat()).unwrap();
    let refused = marf(site.path(), &["exec", "newer.action", "--store", &store]).exits(10);
    assert!(refused.stderr.contains("stage version"), "{}", refused.stderr);
    assert!(
        refused
            .stderr
            .contains("use the marf that planned it, on a machine with the same backend"),
        "{}",
        refused.stderr
    );
}

/// Runs a pipeline, computes each of its nodes again, and returns the names of the parts, which are refused.
fn computed_again(site: &Site) -> BTreeSet<String> {
    marf(site.path(), &["run"]).exits(0);
    let store = format!("file://{}", site.path().join("shared").display());
    marf(site.path(), &["cache", "push", "--remote", &store]).exits(0);
    let own = marf_cache::Store::open(site.path().join(".marf")).unwrap();
    let pushed = walkdir::WalkDir::new(site.path().join("shared/records")).min_depth(2);
    let mut parts = BTreeSet::new();
    for file in pushed {
        let file = file.unwrap().into_path();
        let [folder, name] =
            [file.parent().unwrap(), &file].map(|path| path.file_name().unwrap().to_str().unwrap());
        let key = format!("{folder}{name}");
        let action = marf_cache::Action::decode(&own.get(&key.parse().unwrap()).unwrap()).unwrap();
        let empty = tempfile::tempdir().unwrap();
        let result = empty.path().join("result.json");
        let ran = marf(
            empty.path(),
            &[
                "exec",
                &key,
                "--store",
                &store,
                "--result",
                result.to_str().unwrap(),
            ],
        );
        if action.stage == "extract" {
            let refused = ran.exits(10).stderr;
            assert!(
                refused.contains("stage `extract`, which reads an archive"),
                "{refused}"
            );
            continue;
        }
        if let Some(part) = action.part {
            let refused = ran.exits(10).stderr;
            for expected in [
                &format!(
                    "part `{part}` of stage `{}`, which this program computes only with its node",
                    action.stage
                ),
                "give the key of its node, or use `marf run`",
            ] {
                assert!(refused.contains(expected), "{refused}");
            }
            parts.insert(part);
            continue;
        }
        let told = ran.exits(0).stderr;
        assert!(!told.contains("another result"), "{action:?}: {told}");
        let result: Value = serde_json::from_slice(&std::fs::read(result).unwrap()).unwrap();
        assert_eq!(result["key"], key);
        assert_eq!(result.get("fault"), None);
    }
    parts
}

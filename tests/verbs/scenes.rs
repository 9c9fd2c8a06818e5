//! A mission split by place: a scene a place, a new sol that runs its scene alone, and requests for one scene.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

use super::common::marf;
use super::with_pipeline;

/// The built-in Mars at two sites and, from sol 201 on, a third, with cameras of labels and trainings of two steps.
const MISSION: &str = r#"name = "mission"
[archive.demo]
kind = "demo"
sols = "1,101"
width = 80
[node.extract]
archive = "demo"
[node.scenes]
input = "extract"
[node.calibrate]
input = "scenes"
method = "labels"
[node.ties]
input = "calibrate"
[node.train]
input = "calibrate"
steps = 2
scale = 2
device = "cpu"
"#;

/// Returns the nodes of the last run: state and digests of outputs by name.
fn nodes(dir: &Path) -> BTreeMap<String, (String, Value)> {
    let run: Value = serde_json::from_str(&marf(dir, &["status", "--json"]).exits(0).stdout).unwrap();
    let nodes = run["nodes"].as_array().unwrap().iter();
    let node = |node: &Value| {
        let text = |key: &str| node[key].as_str().unwrap().to_owned();
        (text("name"), (text("state"), node["outputs"].clone()))
    };
    nodes.map(node).collect()
}

fn in_state<'n>(nodes: &'n BTreeMap<String, (String, Value)>, state: &str) -> Vec<&'n str> {
    let of = nodes.iter().filter(|(_, (of, _))| of == state);
    of.map(|(name, _)| name.as_str()).collect()
}

#[test]
fn each_place_is_a_scene_and_a_new_sol_runs_its_scene_alone() {
    let dir = with_pipeline(MISSION);
    let dir = dir.path();
    let run = marf(dir, &["run"]).exits(0);
    assert!(run.stdout.contains("2 scenes"), "{}", run.stdout);
    let first = nodes(dir);
    let names: Vec<&str> = first.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "calibrate@site1-20",
            "calibrate@site2-20",
            "extract",
            "scenes",
            "ties",
            "train@site1-20",
            "train@site2-20"
        ]
    );
    // What joins scenes runs once, and reads each by its name.
    let ties = std::fs::read_to_string(dir.join("out/ties/ties.json")).unwrap();
    let ties: Value = serde_json::from_str(&ties).unwrap();
    let frames: Vec<&str> = (0..2)
        .map(|scene| ties["scenes"][scene]["frame"].as_str().unwrap())
        .collect();
    assert_eq!(frames, ["site 1", "site 2"], "{ties}");
    assert_eq!(ties["ties"].as_array().unwrap().len(), 0);
    // The graph leads from what splits to what joins, past the scenes.
    let report = std::fs::read_to_string(dir.join("out/report.html")).unwrap();
    let graph = report.split("id=\"graph\"").nth(1).unwrap();
    let lines = graph
        .split("</svg>")
        .next()
        .unwrap()
        .matches("class=\"edge\"")
        .count();
    assert_eq!(
        lines,
        2 + 2,
        "a line and its head, of extract to scenes and scenes to ties"
    );
    let why = marf(dir, &["why", "ties"]).exits(0).stdout;
    assert!(why.contains("nothing changed"), "{why}");
    for page in ["report.html", "pages/site1-20.html", "pages/site2-20.html"] {
        let page = std::fs::read_to_string(dir.join("out").join(page)).unwrap();
        assert!(page.contains("site1-20") || page.contains("site2-20"));
    }
    let report = std::fs::read_to_string(dir.join("out/report.html")).unwrap();
    assert!(report.contains("href=\"pages/site2-20.html\"") && report.contains("class=\"traverse\""));
    assert!(
        dir.join("out/scenes/scenes.json").exists() && dir.join("out/train@site1-20/metrics.json").exists()
    );

    // Nothing new: nothing runs.
    marf(dir, &["run"]).exits(0);
    assert!(in_state(&nodes(dir), "finished").is_empty());

    // A further sol at the second place, and the first at a third.
    let sols = "archive.demo.sols=1,101,102,201";
    let plan = marf(dir, &["plan", "--set", sols]).exits(0).stdout;
    assert!(plan.contains("train@site1-20"), "{plan}");
    marf(dir, &["run", "--set", sols]).exits(0);
    let second = nodes(dir);
    assert_eq!(
        in_state(&second, "finished"),
        [
            "calibrate@site2-20",
            "calibrate@site3-20",
            "ties",
            "train@site2-20",
            "train@site3-20"
        ]
    );
    for node in ["calibrate@site1-20", "train@site1-20"] {
        assert_eq!(first[node].1, second[node].1, "{node}");
    }
    assert_ne!(first["train@site2-20"].1, second["train@site2-20"].1);
    // As it was before: all is kept, and the page of a place that is gone is removed.
    marf(dir, &["run"]).exits(0);
    assert!(in_state(&nodes(dir), "finished").is_empty());
    assert!(!dir.join("out/pages/site3-20.html").exists() && dir.join("out/pages/site2-20.html").exists());
}

#[test]
fn one_scene_is_run_by_its_name() {
    let dir = with_pipeline(MISSION);
    let dir = dir.path();
    marf(dir, &["run", "--scene", "site2-20"]).exits(0);
    let run = nodes(dir);
    assert_eq!(
        in_state(&run, "finished"),
        ["calibrate@site2-20", "train@site2-20"],
        "{run:?}"
    );
    let unknown = marf(dir, &["run", "--scene", "site9"]).exits(2);
    assert!(
        unknown.stderr.contains("the scenes are site1-20, site2-20"),
        "{}",
        unknown.stderr
    );
    // A node's own name selects it in all scenes.
    marf(dir, &["run", "--to", "calibrate"]).exits(0);
    let run = nodes(dir);
    assert_eq!(run["calibrate@site1-20"].0, "finished", "{run:?}");
    let whole = MISSION.replace("input = \"scenes\"", "input = \"extract\"");
    let whole = with_pipeline(&whole.replace("[node.scenes]\ninput = \"extract\"\n", ""));
    let refused = marf(whole.path(), &["run", "--scene", "site1-20"]).exits(2);
    assert!(
        refused.stderr.contains("does not split its photos"),
        "{}",
        refused.stderr
    );
}

#[test]
fn what_is_no_scene_is_named_and_the_rest_goes_on() {
    let dir = with_pipeline(MISSION);
    let dir = dir.path();
    let few = ["run", "--to", "scenes", "--set", "scenes.min_photos=300"];
    let refused = marf(dir, &few).exits(1);
    assert!(refused.stderr.contains("none of 2 groups"), "{}", refused.stderr);
    assert!(
        refused.stderr.contains("`min_photos` asks for 300"),
        "{}",
        refused.stderr
    );
    let by_hand = "scenes.groups.delta={sols=[1],ids=[\"nothing\"]}";
    let run = marf(dir, &["run", "--to", "calibrate", "--set", by_hand]).exits(0);
    assert!(run.stdout.contains("calibrate@delta"), "{}", run.stdout);
    let scenes = std::fs::read_to_string(dir.join("out/scenes/scenes.json")).unwrap();
    assert!(scenes.contains("`nothing` names no photo"), "{scenes}");
    let bad = marf(dir, &["run", "--set", "scenes.max_span_m=0"]).exits(2);
    assert!(bad.stderr.contains("node.scenes.max_span_m"), "{}", bad.stderr);
}

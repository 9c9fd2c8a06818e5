//! `marf trade`: every point an ordinary training, what comes out, and what is refused.

use std::path::Path;

use serde_json::Value;

use super::common::marf;

/// The built-in Mars with cameras of labels and a training of two steps. One value of a knob is not a scale of these
/// photos.
const PIPELINE: &str = r#"name = "small"
[archive.demo]
kind = "demo"
sols = "1"
width = 160
[node.extract]
archive = "demo"
[node.calibrate]
input = "extract"
method = "labels"
[node.train]
input = "calibrate"
steps = 2
scale = 4
device = "cpu"
[trade]
"train.steps" = [4]
"train.scale" = [5, 9999]
"#;

fn written(pipeline: &str) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("pipeline.toml"), pipeline).unwrap();
    dir
}

fn traded(dir: &Path, more: &[&str]) -> Value {
    let mut args = vec!["trade", "--seeds", "2", "--random", "1", "--json"];
    args.extend(more);
    let told = marf(dir, &args).exits(0).stdout;
    serde_json::from_str(&told).unwrap()
}

#[test]
fn a_trade_has_points_effects_and_a_front_and_is_kept() {
    let dir = written(PIPELINE);
    let trade = traded(dir.path(), &[]);
    let points = trade["points"].as_array().unwrap();
    let sets: Vec<String> = points.iter().map(|point| point["sets"].to_string()).collect();
    assert_eq!(
        sets[..4],
        [
            "[]",
            "[\"train.scale=5\"]",
            "[\"train.scale=9999\"]",
            "[\"train.steps=4\"]"
        ]
    );
    let runs: Vec<usize> = points
        .iter()
        .map(|point| point["runs"].as_array().unwrap().len())
        .collect();
    assert_eq!(runs[..4], [2, 2, 0, 2], "{trade}");
    assert!(
        points[2]["fault"].as_str().unwrap().contains("`scale` 9999"),
        "{trade}"
    );
    let cores = std::thread::available_parallelism().unwrap();
    let machine = trade["machine"].as_str().unwrap();
    assert!(
        machine.ends_with(&format!(", {cores} cores, {}", std::env::consts::OS)),
        "{machine}"
    );
    let effects = trade["effects"].as_array().unwrap();
    assert_eq!(effects.len(), 2, "{trade}");
    let judged = points.iter().flat_map(|point| point["runs"].as_array().unwrap());
    assert!(
        judged.into_iter().all(|run| run["judged_scale"] == 4),
        "photos of one size judge all: {trade}"
    );
    assert!(
        effects.iter().all(|effect| effect["gain_db"]["half"].is_number()),
        "{trade}"
    );
    assert!(!trade["front"].as_array().unwrap().is_empty());
    for run in points.iter().flat_map(|point| point["runs"].as_array().unwrap()) {
        assert!(
            run["train_s"].as_f64().unwrap() > 0.0 && run["bytes"].as_u64().unwrap() > 0,
            "{run}"
        );
    }
    let out = dir.path().join("out/trade");
    let text = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    assert_eq!(
        text("trade.csv").lines().count(),
        1 + runs.iter().sum::<usize>() + 1
    );
    assert!(text("front.svg").starts_with("<svg xmlns=") && text("effects.svg").contains("train.steps=4"));
    assert!(text("report.html").contains("Time against quality"));
    assert_eq!(
        traded(dir.path(), &[]),
        trade,
        "nothing is trained or timed again"
    );
    let told = marf(dir.path(), &["run"]).exits(0).stdout;
    assert!(told.contains("train"), "{told}");
    let report = std::fs::read_to_string(dir.path().join("out/report.html")).unwrap();
    assert!(
        report.contains("train.steps=4:"),
        "the report of the pipeline has the trade"
    );
    let status = marf(dir.path(), &["status"]).exits(0).stdout;
    assert!(!status.contains("(trade)"), "{status}");
    let few = traded(dir.path(), &["--knob", "train.steps"]);
    assert_eq!(few["effects"].as_array().unwrap().len(), 1);
}

#[test]
fn what_cannot_be_traded_is_refused_with_the_way_out() {
    for (pipeline, args, words) in [
        (
            PIPELINE.to_owned(),
            vec!["--knob", "train.levels"],
            "the knobs are train.scale, train.steps",
        ),
        (
            PIPELINE.replace("steps = 2", "budget = \"1s\""),
            vec![],
            "`train.budget` fixes the time",
        ),
        (
            PIPELINE.replace("steps = 2", "steps = 2\nwarm_start = true"),
            vec![],
            "`train.warm_start` would start each training from the one before, and none could be compared",
        ),
        (
            PIPELINE.replace("[5, 9999]", "10"),
            vec![],
            "`trade.train.scale` is not a key of a node with a list",
        ),
        (
            PIPELINE.replace("\"train.scale\" =", "scale ="),
            vec![],
            "`trade.scale` is not a key of a node",
        ),
    ] {
        let dir = written(&pipeline);
        let mut command = vec!["trade"];
        command.extend(&args);
        let told = marf(dir.path(), &command).exits(2);
        assert!(told.stderr.contains(words), "{words}: {}", told.stderr);
    }
}

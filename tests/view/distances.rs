//! Distances by what pairs of photos saw.

use serde_json::json;

use super::Viewer;
use super::common::marf;

const PAIRS: &str = "name = \"pairs\"\n[archive.demo]\nkind = \"demo\"\nsols = \"1\"\nwidth = 320\n\
    [node.extract]\narchive = \"demo\"\n[node.size]\ninput = \"extract\"\nmin_bytes = 3_000\n\
    [node.grayscale]\ninput = \"size\"\n[node.calibrate]\ninput = \"grayscale\"\nmethod = \"labels\"\n\
    [node.depth]\ninput = \"calibrate\"\nneighbours = 1\n\
    [node.train]\ninput = \"calibrate\"\nsteps = 2\nscale = 4\n";

/// A field of two steps shows nothing. Without retrainings it has no interval either.
#[test]
fn pairs_of_photos_measure_what_the_field_does_not_show() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("pipeline.toml"), PAIRS).unwrap();
    marf(dir.path(), &["run", "--to", "train"]).exits(0);
    marf(dir.path(), &["run"]).exits(0);
    let measured = |run: u64| {
        let viewer = Viewer::start(dir.path(), &["--run", &run.to_string()]);
        let scene = viewer.get(&format!("/scene/{run}/0")).is(200).json();
        let photos = scene["photos"].as_array().unwrap();
        let found = photos.iter().map(|photo| {
            let size = ["width", "height"].map(|side| photo["camera"][side].as_u64().unwrap());
            let mark = |across: u64| {
                json!({"camera": photo["camera"], "cam_from_world": photo["cam_from_world"],
                       "pixel": [across * size[0] / 8, 3 * size[1] / 4]})
            };
            let asked = json!({"run": run, "field": 0, "marks": [mark(3), mark(5)]});
            viewer.post("/distance", &asked)
        });
        found.collect::<Vec<_>>()
    };
    for answer in measured(1) {
        if answer.status == 200 {
            let found = answer.json();
            assert_eq!(
                (&found["by_pairs"], &found["interval"]),
                (&json!(0), &json!(null))
            );
        }
    }
    let answers = measured(2);
    let found: Vec<_> = answers
        .iter()
        .filter(|answer| answer.status == 200)
        .map(|answer| answer.json())
        .collect();
    let by_pairs: Vec<_> = found.iter().filter(|found| found["by_pairs"] == 2).collect();
    assert!(
        2 * by_pairs.len() > answers.len(),
        "{} of {}",
        by_pairs.len(),
        answers.len()
    );
    for found in by_pairs {
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        let [low, high] = [0, 1].map(|end| number(&found["interval"][end]));
        let length = number(&found["length"]);
        assert!(
            low < length && length < high && 0.1 < length && length < 20.0,
            "{found}"
        );
    }
}

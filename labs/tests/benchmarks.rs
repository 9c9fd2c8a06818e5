//! The benchmarks, with little to do: what they write and print, and what they refuse.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod common;

use common::{labs, photos};

/// Small networks and long steps.
const SMALL: [&str; 5] = [
    "train.field.log2_table=10",
    "train.field.density_width=16",
    "train.field.color_width=16",
    "train.field.batch_samples=1024",
    "train.field.cone=0.2",
];

fn with_small<'a>(words: &[&'a str]) -> Vec<&'a str> {
    let sets = SMALL.iter().flat_map(|set| ["--set", set]);
    words.iter().copied().chain(sets).collect()
}

#[test]
fn a_bench_prints_one_line_a_budget_and_writes_the_test_views() {
    let dir = photos();
    let verb = ["train", "photos", "--seconds", "2,1", "--out", "out"];
    let ran = labs(dir.path(), &with_small(&verb)).exits(0);
    let lines = ran.events();
    assert_eq!(lines.len(), 2, "{}", ran.stdout);
    for (line, budget) in lines.iter().zip([1, 2]) {
        assert_eq!(line["budget"], budget, "ascending: {line}");
        for key in [
            "clock",
            "cpu_s",
            "steps",
            "rays_per_s",
            "samples_per_s",
            "rss_mb",
            "psnr",
            "ssim",
        ] {
            assert!(
                line[key].as_f64().is_some_and(|value| value > 0.0),
                "{key}: {line}"
            );
        }
        let picture = image::open(dir.path().join(format!("out/{budget}s/3.png"))).unwrap();
        assert_eq!((picture.width(), picture.height()), (32, 24));
    }
    assert!(lines[1]["steps"].as_u64() > lines[0]["steps"].as_u64());
    assert!(
        ran.stderr.contains("Msamples/s") && ran.stderr.contains("at most 100 dB"),
        "{}",
        ran.stderr
    );
}

#[test]
fn a_bench_refuses_keys_that_it_would_not_listen_to() {
    let dir = photos();
    for (set, expected) in [
        ("train.steps=5", "steps"),
        ("train.field.log2_table=99", "log2_table"),
        ("train.field.levls=3", "levls"),
    ] {
        let ran = labs(dir.path(), &["train", "photos", "--set", set]).exits(2);
        assert!(ran.stderr.contains(expected), "{set}: {}", ran.stderr);
    }
    let ran = labs(dir.path(), &["train", "photos", "--seconds", "soon"]).exits(2);
    assert!(ran.stderr.contains("invalid value 'soon'"), "{}", ran.stderr);
}

#[test]
fn engine_and_items_print_one_line_a_phase_and_nothing_runs_twice() {
    let dir = tempfile::tempdir().unwrap();
    let words = ["engine", "--photos", "40", "--sols", "4", "--rounds", "1"];
    let lines = labs(dir.path(), &words).exits(0).events();
    let phases: Vec<&str> = lines.iter().map(|line| line["phase"].as_str().unwrap()).collect();
    assert_eq!(phases, ["cold", "no change", "new sols", "no change after"]);
    let decided: Vec<&serde_json::Value> = lines.iter().map(|line| &line["decided"]["size"]).collect();
    assert_eq!(
        (decided[0].as_u64(), decided[2].as_u64()),
        (Some(4), Some(10)),
        "{lines:?}"
    );
    assert_eq!(lines[2]["photos"], 140);

    let words = ["items", "--items", "1000", "--sols", "10", "--rounds", "1"];
    let lines = labs(dir.path(), &words).exits(0).events();
    let phases: Vec<&str> = lines.iter().map(|line| line["phase"].as_str().unwrap()).collect();
    assert_eq!(phases, ["fill", "no change", "one new sol"]);
    let nodes = lines[1]["nodes"].as_array().unwrap();
    assert_eq!(nodes.len(), 3, "{nodes:?}");
    assert!(nodes.iter().all(|node| node["state"] == "reused"), "{nodes:?}");
}

#[test]
fn a_plain_is_a_folder_to_train_on() {
    let dir = tempfile::tempdir().unwrap();
    labs(dir.path(), &["plain", "plain", "8", "9", "32"]).exits(0);
    let train = ["train", "plain", "--steps", "2", "--out", "out"];
    let lines = labs(dir.path(), &with_small(&train)).exits(0).events();
    assert_eq!(lines[0]["steps"], 2);
}

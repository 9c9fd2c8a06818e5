//! Who made a file, from which bytes: `marf audit`, `marf replay`, and keys that a stranger computes again.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop; a skipped test says so"
)]

mod altered;
mod changes;
#[path = "../common/mod.rs"]
mod common;
mod replay;
mod sentences;

use std::path::Path;
use std::process::Command;

use common::{copy, marf};
use marf_provenance::stamp::Stamp;
use serde_json::Value;

/// The built-in Mars with cameras of labels and a short training, in seconds.
const PIPELINE: &str = r#"name = "audit"
[archive.demo]
kind = "demo"
sols = "1"
width = 160
[node.extract]
archive = "demo"
[node.blur]
input = "extract"
[node.calibrate]
input = "blur"
method = "labels"
[node.train]
input = "calibrate"
steps = 2
scale = 4
device = "cpu"
"#;

fn ran() -> tempfile::TempDir {
    common::ran("audit", PIPELINE)
}

fn audit(dir: &Path, file: &str, more: &[&str], code: i32) -> Value {
    let mut args = vec!["audit", file, "--json"];
    args.extend(more);
    let told = marf(dir, &args).exits(code);
    serde_json::from_str(&told.stdout).unwrap()
}

/// Every file below a folder, relative to it.
fn files(folder: &Path, below: &Path, found: &mut Vec<String>) {
    for entry in std::fs::read_dir(below).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => files(folder, &path, found),
            false => found.push(path.strip_prefix(folder).unwrap().to_str().unwrap().to_owned()),
        }
    }
}

#[test]
fn every_file_that_a_run_wrote_is_known_wherever_it_lies_and_altered_ones_are_told() {
    let dir = ran();
    let mut written = Vec::new();
    files(&dir.path().join("out"), &dir.path().join("out"), &mut written);
    assert!(
        written.len() > 20 && written.contains(&"report.html".to_owned()),
        "{written:?}"
    );
    let mut marked = std::collections::BTreeSet::new();
    for file in &written {
        let bytes = std::fs::read(dir.path().join("out").join(file)).unwrap();
        std::fs::write(dir.path().join("mailed"), &bytes).unwrap();
        let told = audit(dir.path(), "mailed", &[], 0);
        assert_eq!(told["answer"], "whole", "{file}: {told}");
        let extension = Path::new(file).extension().unwrap().to_str().unwrap();
        if Stamp::take_from(&bytes).is_some() {
            marked.insert(extension.to_owned());
        }
        let mut altered = bytes;
        let middle = altered.len() / 2;
        altered[middle] ^= 1;
        std::fs::write(dir.path().join("mailed"), &altered).unwrap();
        let told = marf(dir.path(), &["audit", "mailed", "--json"]);
        assert_eq!(told.code, 4, "{file}: {}", told.stdout);
        let told: Value = serde_json::from_str(&told.stdout).unwrap();
        let object = audit(dir.path(), &format!("out/{file}"), &[], 0)["object"].clone();
        assert_eq!(told["closest"], object, "{file}");
    }
    let marked: Vec<&str> = marked.iter().map(String::as_str).collect();
    assert_eq!(marked, ["html", "json", "ply", "png"]);
}

#[test]
fn the_lineage_leads_to_the_bytes_and_verifies() {
    let dir = ran();
    let told = audit(dir.path(), "out/train/metrics.json", &["--verify", "--all"], 0);
    let lineage = &told["lineage"][0];
    assert_eq!(lineage["maker"]["place"]["output"]["node"], "train");
    assert!(
        lineage["command"].as_str().unwrap().starts_with("marf run"),
        "{lineage}"
    );
    let nodes: Vec<&str> = lineage["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|node| node["node"].as_str().unwrap())
        .collect();
    assert_eq!(nodes, ["extract", "blur", "calibrate", "train"]);
    let products = lineage["sources"][0]["listed"].as_array().unwrap();
    assert_eq!(lineage["sources"][0]["photos"], products.len());
    for product in products {
        let image = &product["files"]["image"];
        assert_eq!(image["blake3"], product["blobs"]["image"], "{product}");
        assert!(image["sha256"].as_str().unwrap().len() == 64 && product["files"]["label"].is_object());
    }
    assert_eq!(told["verified"]["faults"], serde_json::json!([]));
    assert_eq!(told["verified"]["missing"], serde_json::json!([]));
    let words = marf(dir.path(), &["audit", "out/train/metrics.json", "--all"])
        .exits(0)
        .stdout;
    for part in ["made in run 1", "scene <- calibrate", "photos (", "sha256"] {
        assert!(words.contains(part), "{part}: {words}");
    }
}

#[test]
fn a_foreign_file_and_a_copy_of_another_store_have_answers_of_their_own() {
    let dir = ran();
    std::fs::write(dir.path().join("mine.txt"), "nothing of yours").unwrap();
    assert_eq!(audit(dir.path(), "mine.txt", &[], 3)["answer"], "not_ours");
    std::fs::write(dir.path().join("empty"), "").unwrap();
    audit(dir.path(), "empty", &[], 3);
    marf(dir.path(), &["audit", "absent"]).exits(1);
    marf(dir.path(), &["audit"]).exits(2);
    let other = tempfile::tempdir().unwrap();
    std::fs::write(
        other.path().join("pipeline.toml"),
        PIPELINE.replace("steps = 2", "steps = 1"),
    )
    .unwrap();
    marf(other.path(), &["run"]).exits(0);
    let foreign = other.path().join("out/train/metrics.json");
    let told = audit(dir.path(), foreign.to_str().unwrap(), &[], 5);
    assert_eq!(told["answer"], "incomplete", "{told}");
}

#[test]
fn a_product_leads_to_everything_that_was_made_from_it() {
    let dir = ran();
    let told = audit(dir.path(), "out/train/metrics.json", &["--all"], 0);
    let id = told["lineage"][0]["sources"][0]["listed"][0]["id"]
        .as_str()
        .unwrap()
        .to_owned();
    let from = marf(dir.path(), &["audit", "--from", &id, "--json"]).exits(0);
    let from: Value = serde_json::from_str(&from.stdout).unwrap();
    assert_eq!(from["answer"], "whole");
    let nodes: Vec<&str> = from["runs"][0]["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|node| node["node"].as_str().unwrap())
        .collect();
    assert!(nodes.starts_with(&["extract", "blur"]), "{nodes:?}");
    // For people: a line a node, with the first four outputs and how many more there are.
    let text = marf(dir.path(), &["audit", "--from", &id]).exits(0).stdout;
    for node in from["runs"][0]["nodes"].as_array().unwrap() {
        let words = |value: &Value| -> Vec<String> {
            let texts = value.as_array().unwrap().iter();
            texts.map(|text| text.as_str().unwrap().to_owned()).collect()
        };
        let outputs: Vec<&String> = node["outputs"].as_object().unwrap().keys().collect();
        let first: Vec<&str> = outputs.iter().take(4).map(|name| name.as_str()).collect();
        let more = match outputs.len().saturating_sub(4) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let (name, through) = (node["node"].as_str().unwrap(), words(&node["through"]).join(", "));
        let line = format!(
            "  {name:<22} through {through:<16} into {}{more}",
            first.join(", ")
        );
        assert!(text.lines().any(|found| found == line), "{line}\n{text}");
    }
    // A product that a filter rejected.
    let rejected = marf(dir.path(), &["run", "--set", &format!("reject.ids=[\"{id}\"]")]);
    rejected.exits(0);
    let text = marf(dir.path(), &["audit", "--from", &id]).exits(0).stdout;
    assert!(
        text.contains("  rejected by blur: what follows does not hold it"),
        "{text}"
    );
    marf(dir.path(), &["audit", "--from", "NO_SUCH_PRODUCT"]).exits(3);
}

/// Needs Python with the package blake3.
#[test]
fn a_script_without_our_code_computes_every_key_again() {
    let python = std::env::var("MARF_TEST_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has_blake3 = Command::new(&python).args(["-c", "import blake3"]).output();
    if !has_blake3.is_ok_and(|output| output.status.success()) {
        println!("skipped: needs Python with the package blake3 (MARF_TEST_PYTHON names another)");
        return;
    }
    let dir = ran();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/recompute_keys.py");
    let lines = std::fs::read_to_string(script).unwrap().lines().count();
    assert!(lines <= 40, "{lines} lines");
    let told = || {
        Command::new(&python)
            .arg(script)
            .arg(dir.path().join(".marf"))
            .output()
            .unwrap()
    };
    let output = told();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let records: Value =
        serde_json::from_str(&marf(dir.path(), &["cache", "stat", "--json"]).exits(0).stdout).unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let expected = format!("{} keys, each the blake3 of its action", records["records"]);
    assert!(text.trim_end().ends_with(&expected), "{expected}: {text}");
}

#[test]
fn a_photo_was_read_and_not_made_and_what_it_went_into_is_listed() {
    let dir = tempfile::tempdir().unwrap();
    copy(
        &common::photos().path().join("photos"),
        &dir.path().join("photos"),
    );
    marf(dir.path(), &["filter", "photos", "--out", "verdicts.csv"]).exits(0);
    let words = marf(dir.path(), &["audit", "photos/images/2.png", "--all"])
        .exits(0)
        .stdout;
    for part in ["used in run 1", "  read in run 1"] {
        assert!(words.contains(part), "{part}: {words}");
    }
    assert!(!words.contains("computed by"), "{words}");
    let json = audit(dir.path(), "photos/images/2.png", &[], 0);
    assert_eq!(json["uses"]["runs"][0]["run"], 1, "{json}");
    // What marf made has no uses of this kind.
    let made = audit(dir.path(), "verdicts.csv", &[], 0);
    assert_eq!(made["uses"], Value::Null, "{made}");
}

#[test]
fn what_was_collected_is_named_and_a_changed_archive_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let photos = common::photos();
    copy(&photos.path().join("photos"), &dir.path().join("photos"));
    let text = "name = \"folder\"\n[archive.mine]\nkind = \"folder\"\npath = \"photos\"\n[node.extract]\narchive = \"mine\"\n\
                [node.blur]\ninput = \"extract\"\n";
    std::fs::write(dir.path().join("pipeline.toml"), text).unwrap();
    marf(dir.path(), &["run"]).exits(0);
    audit(dir.path(), "out/report.html", &["--verify"], 0);
    let photo = dir.path().join("photos/images/2.png");
    let bytes = std::fs::read(&photo).unwrap();
    std::fs::write(&photo, &bytes[..bytes.len() - 1]).unwrap();
    let told = audit(dir.path(), "out/report.html", &["--verify"], 6);
    assert_eq!(told["changed"][0]["file"], "images/2.png");
    // The photos of the run are in the store, so that it can be made again all the same.
    marf(dir.path(), &["replay", "1"]).exits(0);
    // Another run takes the place of the first, which is given up.
    marf(dir.path(), &["run", "--set", "blur.min_share=0.7"]).exits(0);
    std::fs::copy(dir.path().join("out/report.html"), dir.path().join("kept.html")).unwrap();
    std::fs::remove_file(dir.path().join(".marf/runs").join(oldest_run(dir.path()))).unwrap();
    let record = format!(
        "{}",
        audit(dir.path(), "kept.html", &["--verify"], 0)["lineage"][0]["run"]
    );
    assert_eq!(record, "2");
}

fn oldest_run(dir: &Path) -> String {
    let mut names: Vec<String> = std::fs::read_dir(dir.join(".marf/runs"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names.swap_remove(0)
}

/// A file that was mailed away has no store: the crate of its run answers, from the bytes of the file or of its copy in `out/`.
#[test]
fn a_crate_tells_who_made_a_file_where_there_is_no_store() {
    let dir = ran();
    marf(dir.path(), &["export", "crate", "crate"]).exits(0);
    let away = tempfile::tempdir().unwrap();
    copy(&dir.path().join("crate"), &away.path().join("crate"));
    let metrics = "metrics.json";
    std::fs::copy(
        dir.path().join("out/train").join(metrics),
        away.path().join(metrics),
    )
    .unwrap();
    std::fs::write(away.path().join("other.txt"), "not ours").unwrap();
    let ask = |file: &str, code: i32| marf(away.path(), &["audit", file, "--crate", "crate"]).exits(code);
    let told = marf(away.path(), &["audit", metrics, "--crate", "crate", "--all"]).exits(0);
    for words in ["output `metrics` of node `train`", "extract", "photos from "] {
        assert!(told.stdout.contains(words), "{words}: {}", told.stdout);
    }
    let json = marf(away.path(), &["audit", metrics, "--crate", "crate", "--json"]).exits(0);
    let document: Value = serde_json::from_str(&json.stdout).unwrap();
    assert_eq!(document["answer"], "whole", "{}", json.stdout);
    let other = ask("other.txt", 3).stderr;
    assert!(
        other.contains("other.txt has the bytes of nothing that the run of crate made: it is another file, or it was altered"),
        "{other}"
    );
    // A short answer says how much more there is.
    let number = |key: &str| document[key].as_array().unwrap().len();
    let short = ask(metrics, 0).stdout;
    let more = format!(
        "`--all` lists the inputs and files of {} steps and {} photos",
        number("steps"),
        number("products")
    );
    assert!(short.contains(&more), "{more}: {short}");
    let text = std::fs::read_to_string(away.path().join(metrics)).unwrap();
    std::fs::write(away.path().join(metrics), text.replacen('1', "2", 1)).unwrap();
    assert!([3, 4].contains(&marf(away.path(), &["audit", metrics, "--crate", "crate"]).code));
    let graph = away.path().join("crate/data/ro-crate-metadata.json");
    std::fs::write(&graph, std::fs::read_to_string(&graph).unwrap() + " ").unwrap();
    ask("other.txt", 4);
}

/// metrics.json of `marf fit` is a document of the run of the last time. Its seconds are those of the training that made
/// it.
#[test]
fn the_metrics_of_fit_are_known_and_stay_where_nothing_is_trained() {
    let dir = common::photos();
    let mut fit = vec!["fit", "photos", "--budget", "1s,2s", "--device", "cpu"];
    for set in [
        "train.field.log2_table=10",
        "train.field.density_width=16",
        "train.field.color_width=16",
        "train.field.batch_samples=1024",
        "train.field.cone=0.2",
        "train.field.occupancy_resolution=16",
    ] {
        fit.extend(["--set", set]);
    }
    let told = marf(dir.path(), &[&fit[..], &["--json"]].concat()).exits(0);
    assert!(told.stdout.contains("\"samples_per_s\""), "{}", told.stdout);
    let told: Value = serde_json::from_str(&told.stdout).unwrap();
    let judged = &told["1s"]["judged"];
    let [width, height] = [0, 1].map(|side| judged["sizes_px"][0][side].as_u64().unwrap() as u32);
    let pictures: Vec<_> = std::fs::read_dir(dir.path().join(judged["pictures"].as_str().unwrap()))
        .unwrap()
        .map(|entry| image::image_dimensions(entry.unwrap().path()).unwrap())
        .collect();
    let views = told["1s"]["views"].as_array().unwrap().len();
    assert_eq!(pictures, vec![(2 * width, height); views], "{judged}");
    let path = dir.path().join("fit/metrics.json");
    let object = || String::from_utf8(Stamp::take_from(&std::fs::read(&path).unwrap()).unwrap().0).unwrap();
    let first = object();
    let metrics: Value = serde_json::from_str(&first).unwrap();
    let budgets: Vec<&str> = metrics.as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(budgets, ["1s", "2s"]);
    assert!(metrics["2s"]["psnr"].is_f64() && metrics["2s"]["key"] != metrics["1s"]["key"]);
    let seconds = |time: &str, key: &str| metrics[time][key].as_f64().unwrap();
    for time in ["1s", "2s"] {
        let (training, judging) = (seconds(time, "train_seconds"), seconds(time, "judging_seconds"));
        assert!(training > 0.0 && judging > 0.0 && seconds(time, "expected_seconds") > 0.0);
        assert!(training + judging <= seconds(time, "seconds"), "{first}");
    }
    let told = audit(dir.path(), "fit/metrics.json", &["--verify"], 0);
    let place = &told["lineage"][0]["maker"]["place"];
    assert_eq!(place["document"], "metrics.json", "{told}");
    // Again, where nothing is trained.
    marf(dir.path(), &fit).exits(0);
    assert_eq!(object(), first);
}

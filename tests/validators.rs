//! Crates and statements before the public validators (roc-validator, bagit, in-toto), and altered ones before ours too.
//!
//! The validators are installed with pip into `target/validators`. Without Python or a package index the test says so and is
//! skipped.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop; a skipped test says so"
)]

mod common;

use std::path::{Path, PathBuf};
use std::process::Command;

use common::{SMALL_DEMO, copy, marf, tools};
use serde_json::Value;

/// Test 1 of RFC 8032, section 7.1.
const PRIVATE_PEM: &str = "-----BEGIN PRIVATE KEY-----\n\
    MC4CAQAwBQYDK2VwBCIEIJ1hsZ3v/VpguoRK9JLsLMREScVpezJpGXA7rAMcrn9g\n\
    -----END PRIVATE KEY-----\n";
const PUBLIC_PEM: &str = "-----BEGIN PUBLIC KEY-----\n\
    MCowBQYDK2VwAyEA11qYAYKxCrfVS/7TyWQHOg7hcvPapiMlrwIaaPcHURo=\n\
    -----END PUBLIC KEY-----\n";
/// It holds the JSON-LD context of RO-Crate 1.1. Its dependencies are not needed for that.
const CONTEXT_PACKAGE: &str = "rocrate==0.13.0";

/// Returns a Python that has the validators.
fn python() -> Option<PathBuf> {
    let requirements = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/validators/requirements.txt");
    let wanted = std::fs::read_to_string(&requirements).unwrap() + CONTEXT_PACKAGE;
    let whole = vec!["-r", requirements.to_str().unwrap()];
    let context = vec!["--no-deps", CONTEXT_PACKAGE];
    tools::python("validators", &wanted, &[whole, context])
}

/// Changes the graph of a crate.
fn edit(folder: &Path, change: impl FnOnce(&mut Vec<Value>)) {
    let path = folder.join("data/ro-crate-metadata.json");
    let mut graph: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    change(graph["@graph"].as_array_mut().unwrap());
    std::fs::write(path, graph.to_string()).unwrap();
}

fn entity<'a>(graph: &'a mut [Value], id: &str) -> &'a mut Value {
    graph.iter_mut().find(|entity| entity["@id"] == id).unwrap()
}

/// Writes crates of a run into a folder: three that hold, and four copies of the first that were altered.
fn crates(folder: &Path) -> PathBuf {
    marf(folder, &["init"]).exits(0);
    let mut run = vec!["run", "--set", "archive.demo.sols=1"];
    run.extend(SMALL_DEMO.iter().flat_map(|set| ["--set", set]));
    marf(folder, &run).exits(0);
    let told: Value = serde_json::from_str(&marf(folder, &["photos", "--json"]).exits(0).stdout).unwrap();
    let photos = &told["photos"];
    let photo = photos[0]["product"].as_str().unwrap().to_owned();
    std::fs::write(folder.join("key.pem"), PRIVATE_PEM).unwrap();
    std::fs::write(folder.join("pub.pem"), PUBLIC_PEM).unwrap();
    let all = folder.join("crates");
    std::fs::create_dir(&all).unwrap();
    let export = ["export", "crate"];
    marf(
        folder,
        &[&export[..], &["crates/whole", "--key", "key.pem"]].concat(),
    )
    .exits(0);
    marf(
        folder,
        &[&export[..], &["crates/record", "--without-data"]].concat(),
    )
    .exits(0);
    marf(
        folder,
        &[&export[..], &["crates/items", "--items", &photo]].concat(),
    )
    .exits(0);
    let altered = |name: &str| {
        copy(&all.join("whole"), &all.join(name));
        all.join(name)
    };
    edit(&altered("no-instrument"), |graph| {
        let action = entity(graph, "#action/calibrate").as_object_mut().unwrap();
        action.remove("instrument");
    });
    std::fs::remove_file(altered("file-missing").join("data/outputs/train/metrics.json")).unwrap();
    edit(&altered("reference-to-nothing"), |graph| {
        entity(graph, "#action/calibrate")["result"][0]["@id"] = "outputs/nothing.json".into();
    });
    let metrics = altered("bytes-changed").join("data/outputs/train/metrics.json");
    let mut bytes = std::fs::read(&metrics).unwrap();
    bytes[7] ^= 1;
    std::fs::write(&metrics, bytes).unwrap();
    all
}

/// Returns whether a validator passed a case.
fn passed(answers: &[Value], validator: &str, case: &str) -> bool {
    let answer = answers
        .iter()
        .find(|answer| answer["validator"] == validator && answer["case"] == case);
    let answer = answer.unwrap_or_else(|| panic!("{validator} did not look at {case}"));
    println!("{answer}");
    answer["passed"] == true
}

#[test]
fn the_public_validators_accept_what_we_write_and_ours_finds_more_than_they() {
    let Some(python) = python() else { return };
    let dir = tempfile::tempdir().unwrap();
    let all = crates(dir.path());
    let attest = [
        "export",
        "attest",
        "--key",
        "key.pem",
        "--out",
        "train.json",
        "train",
    ];
    marf(dir.path(), &attest).exits(0);

    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/validators/validate.py");
    let output = Command::new(python)
        .arg(script)
        .args([
            all.as_path(),
            &dir.path().join("train.json"),
            &dir.path().join("pub.pem"),
        ])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let answers: Vec<Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();

    assert!(passed(&answers, "in-toto", "statement"));
    for case in ["whole", "record", "items"] {
        assert!(passed(&answers, "roc-validator", case), "{case}");
        assert!(passed(&answers, "bagit", case), "{case}");
        marf(dir.path(), &["verify", &format!("crates/{case}")]).exits(0);
    }
    for case in ["no-instrument", "file-missing"] {
        assert!(!passed(&answers, "roc-validator", case), "{case}");
    }
    for (case, fault) in [
        ("no-instrument", "the instrument of `#action/calibrate`"),
        ("file-missing", "`data/outputs/train/metrics.json` is missing"),
        (
            "reference-to-nothing",
            "`outputs/nothing.json`, which is not in the graph",
        ),
        ("bytes-changed", "`data/outputs/train/metrics.json` was altered"),
    ] {
        assert!(!passed(&answers, "bagit", case), "{case}");
        passed(&answers, "roc-validator", case);
        let ran = marf(dir.path(), &["verify", &format!("crates/{case}")]).exits(4);
        assert!(ran.stdout.contains(fault), "{case}: {}", ran.stdout);
    }
}

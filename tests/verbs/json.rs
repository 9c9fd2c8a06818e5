//! `--json`: one document on stdout, or lines of events of a run, and nothing else.

use std::path::Path;

use serde_json::Value;

use crate::common::{marf, photos};

/// The built-in Mars with a field of few steps that has a surface.
const PIPELINE: &str = r#"name = "json"
[archive.demo]
kind = "demo"
sols = "1"
width = 160

[node.extract]
archive = "demo"

[node.shape]
input = "extract"
min_width = 160
min_height = 120

[node.calibrate]
input = "shape"
method = "labels"

[node.train]
input = "calibrate"
steps = 200
scale = 1
field.batch_samples = 16384
device = "cpu"

[trade]
"train.steps" = [4]
"#;

const KEY: &str = "-----BEGIN PRIVATE KEY-----\n\
    MC4CAQAwBQYDK2VwBCIEIJ1hsZ3v/VpguoRK9JLsLMREScVpezJpGXA7rAMcrn9g\n\
    -----END PRIVATE KEY-----\n";
const PUBLIC_KEY: &str = "-----BEGIN PUBLIC KEY-----\n\
    MCowBQYDK2VwAyEA11qYAYKxCrfVS/7TyWQHOg7hcvPapiMlrwIaaPcHURo=\n\
    -----END PUBLIC KEY-----\n";

/// Verbs that print a document, in an order in which each finds what it needs.
const VERBS: [&str; 35] = [
    "plan",
    "why train",
    "why train --files",
    "status",
    "log",
    "photos",
    "photos photos",
    "filter photos",
    "calibrate photos --method import --out cameras/transforms.json",
    "depth photos --out depths --method import",
    "fit photos --budget 1s --device cpu --set train.field.log2_table=10 --set train.field.batch_samples=1024",
    "render --frames 1 --width 40 --out rendered --device cpu",
    "export crate crate",
    "export cameras --out colmap",
    "export mesh --out mesh.ply --cell 0.05 --most-spread 5 --least-photos 1",
    "export points --out points.ply --cell 0.05 --most-spread 5 --least-photos 1",
    "export splats --out splats.ply --cell 0.05 --most-spread 5 --least-photos 1",
    "export height --out height.tif --cell 0.05 --most-spread 5 --least-photos 1",
    "export orthophoto --out above.png --cell 0.05 --most-spread 5 --least-photos 1",
    "export depth --out depth --cell 0.05 --most-spread 5 --least-photos 1",
    "verify crate",
    "verify signed.json --key pub.pem",
    "audit out/train/weights.safetensors",
    "audit out/train/weights.safetensors --crate crate",
    "replay calibrate",
    "diff 1 2",
    "trade --seeds 1 --steps 2",
    "key new --out made.pem",
    "cache stat",
    "cache push --remote file://SHARED",
    "cache pull --remote file://SHARED",
    "cache gc --dry-run",
    "cache gc --dry-run --remote file://SHARED",
    "cache fsck",
    "cache fsck --remote file://SHARED",
];

/// Calls that fail, with their exit codes.
const FAILING: [(&str, i32); 9] = [
    ("plan --set trian.steps=3", 2),
    ("why none", 2),
    ("photos --node none", 2),
    ("filter none", 1),
    ("fit photos --budget 1s --set train.steps=0", 2),
    ("render --run 99 --out rendered", 1),
    ("export mesh none --out mesh.ply", 2),
    ("diff 1 99", 1),
    ("verify crate --key none.pem", 2),
];

fn call(folder: &Path, line: &str) -> (i32, String, String) {
    let line = line.replace("SHARED", &folder.join("shared").to_string_lossy());
    let args: Vec<&str> = line.split(' ').chain(["--json"]).collect();
    let ran = marf(folder, &args);
    (ran.code, ran.stdout, ran.stderr)
}

#[test]
fn every_verb_prints_one_document_and_a_failing_one_none() {
    let dir = photos();
    let folder = dir.path();
    for (name, text) in [
        ("pipeline.toml", PIPELINE),
        ("key.pem", KEY),
        ("pub.pem", PUBLIC_KEY),
    ] {
        std::fs::write(folder.join(name), text).unwrap();
    }
    marf(folder, &["run", "--to", "calibrate"]).exits(0);
    let (code, events, stderr) = call(folder, "run");
    assert_eq!(code, 0, "{stderr}");
    for line in events.lines() {
        let event: Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"));
        assert!(event["event"].is_string(), "{line}");
    }
    marf(
        folder,
        &["export", "attest", "--key", "key.pem", "--out", "signed.json"],
    )
    .exits(0);
    for verb in VERBS {
        let (code, stdout, stderr) = call(folder, verb);
        assert_eq!(code, 0, "{verb}: {stderr}");
        let document: Result<Value, _> = serde_json::from_str(&stdout);
        assert!(document.is_ok(), "{verb}: {}: {stdout}", document.unwrap_err());
    }
    for (verb, code) in FAILING {
        let (found, stdout, stderr) = call(folder, verb);
        assert_eq!((found, stdout.as_str()), (code, ""), "{verb}: {stderr}");
        assert!(stderr.contains("error: "), "{verb}: {stderr}");
    }
}

/// Every page of the help that has `--json` is of a verb that the test above calls.
#[test]
fn every_verb_with_json_is_called() {
    let folder = Path::new(".");
    let mut pages = vec![String::new()];
    let mut verbs = Vec::new();
    while let Some(verb) = pages.pop() {
        let words: Vec<&str> = verb.split_whitespace().chain(["--help"]).collect();
        let help = marf(folder, &words).exits(0).stdout;
        if help.contains("      --json ") || help.contains("      --json\n") {
            verbs.push(verb.clone());
        }
        let names = help
            .lines()
            .filter(|line| line.starts_with("  ") && !line.starts_with("   "));
        let below = verb.is_empty() || help.contains("\nCommands:\n");
        let names = names.filter_map(|line| line.split_whitespace().next());
        let names = names
            .filter(|name| below && !name.starts_with(['-', '[', '<']) && !["help", "bench"].contains(name));
        pages.extend(names.map(|name| format!("{verb} {name}").trim().to_owned()));
    }
    assert!(verbs.len() > 20, "{verbs:?}");
    // The events of a run are read above, and other tests read the documents of a comparison and of a check of archives.
    let is_called = |verb: &&String| {
        ["run", "compare", "archive check"].contains(&verb.as_str())
            || VERBS.iter().any(|call| call.starts_with(verb.as_str()))
    };
    let missing: Vec<&String> = verbs.iter().filter(|verb| !is_called(verb)).collect();
    assert!(missing.is_empty(), "{missing:?}");
}

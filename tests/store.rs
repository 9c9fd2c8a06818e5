//! The store as its users meet it: damage, collections, checks, old stores.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod common;

use std::path::{Path, PathBuf};

use common::{marf, photos};

/// Filters and cameras of the built-in Mars, in a second.
const PIPELINE: &str = concat!(
    "name = \"store\"\n[archive.photos]\nkind = \"demo\"\nsols = \"1\"\nwidth = 160\n",
    include_str!("../labs/five_nodes.toml"),
    "[node.calibrate]\ninput = \"blur\"\nmethod = \"labels\"\n",
);

fn pipeline() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("pipeline.toml"), PIPELINE).unwrap();
    dir
}

/// Returns the digest of an output of a node in the last run.
fn output(dir: &Path, node: &str, output: &str) -> String {
    let status = marf(dir, &["status", "--json"]).exits(0);
    let run: serde_json::Value = serde_json::from_str(&status.stdout).unwrap();
    let nodes = run["nodes"].as_array().unwrap();
    let found = nodes.iter().find(|one| one["name"] == node).unwrap();
    found["outputs"][output]["digest"].as_str().unwrap().to_owned()
}

/// Flips a bit in the bytes of a blob, wherever they are stored.
fn damage(dir: &Path, digest: &str) {
    let loose = dir.join(".marf/cas").join(&digest[..2]).join(&digest[2..]);
    let packs = std::fs::read_dir(dir.join(".marf/packs")).unwrap();
    let packs = packs.map(|entry| entry.unwrap().path());
    let mut files: Vec<(PathBuf, usize)> = packs
        .filter(|path| path.extension().is_some_and(|extension| extension == "pack"))
        .filter_map(|path| {
            let at = place_in_pack(&std::fs::read(&path).unwrap(), digest)?;
            Some((path, at))
        })
        .collect();
    files.extend(loose.is_file().then_some((loose, 0)));
    assert!(!files.is_empty(), "{digest} is nowhere");
    for (path, at) in files {
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[at] ^= 1;
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, bytes).unwrap();
    }
}

/// Where the bytes of a blob begin in a pack: behind its digest and its length. Lists name digests too, without the bytes.
fn place_in_pack(pack: &[u8], digest: &str) -> Option<usize> {
    let wanted: marf_cache::Digest = digest.parse().unwrap();
    let named = pack.windows(32).enumerate();
    let named = named.filter(|(_, window)| *window == wanted.as_bytes());
    named.map(|(at, _)| at + 36).find(|&at| {
        let bytes = pack
            .get(at - 4..at)
            .and_then(|len| Some(u32::from_le_bytes(len.try_into().ok()?)));
        let blob = bytes.and_then(|len| pack.get(at..at + len as usize));
        blob.is_some_and(|blob| marf_cache::Digest::from_content(blob) == wanted)
    })
}

#[test]
fn a_damaged_output_of_a_last_node_is_made_again_by_the_run_that_writes_it_out() {
    let dir = common::ran("store", PIPELINE);
    let scene = output(dir.path(), "calibrate", "scene");
    damage(dir.path(), &scene);
    std::fs::remove_dir_all(dir.path().join("out")).unwrap();
    let ran = marf(dir.path(), &["run"]).exits(0);
    assert!(ran.stderr.contains("It is computed again"), "{}", ran.stderr);
    assert!(dir.path().join("out/calibrate/scene.json").is_file());
    assert_eq!(output(dir.path(), "calibrate", "scene"), scene);
}

/// The leaf of a set is behind an output, and no other node reads these verdicts.
#[test]
fn a_lost_leaf_of_verdicts_is_made_again_by_the_run_that_writes_them_out() {
    let dir = common::ran("store", PIPELINE);
    let file = dir.path().join("out/blur/verdicts/sol-00001.jsonl");
    let verdicts = std::fs::read(&file).unwrap();
    let leaf = marf_cache::Digest::from_content(&verdicts).to_string();
    assert_ne!(
        leaf,
        output(dir.path(), "blur", "verdicts"),
        "an object behind the output"
    );
    damage(dir.path(), &leaf);
    std::fs::remove_dir_all(dir.path().join("out")).unwrap();
    let ran = marf(dir.path(), &["run"]).exits(0);
    assert_eq!(
        ran.stderr.matches("It is computed again").count(),
        1,
        "{}",
        ran.stderr
    );
    assert_eq!(std::fs::read(&file).unwrap(), verdicts);
    let again = marf(dir.path(), &["run", "--json"]).exits(0);
    assert_eq!(again.nodes("finished"), Vec::<String>::new());
    marf(dir.path(), &["cache", "fsck", "--read-data"]).exits(0);
}

#[test]
fn files_of_outputs_that_nobody_touched_stay_and_those_that_somebody_did_come_back() {
    let dir = common::ran("store", PIPELINE);
    let verdicts = dir.path().join("out/blur/verdicts/sol-00001.jsonl");
    let before = std::fs::read(&verdicts).unwrap();
    std::fs::remove_file(&verdicts).unwrap();
    std::fs::write(dir.path().join("out/calibrate/scene.json"), "mine").unwrap();
    marf(dir.path(), &["run"]).exits(0);
    assert_eq!(std::fs::read(&verdicts).unwrap(), before);
    assert_ne!(
        std::fs::read(dir.path().join("out/calibrate/scene.json")).unwrap(),
        b"mine"
    );
}

#[test]
fn an_unreadable_run_stops_no_verb() {
    let dir = common::ran("store", PIPELINE);
    let runs = std::fs::read_dir(dir.path().join(".marf/runs")).unwrap();
    for run in runs {
        let path = run.unwrap().path();
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, b"{").unwrap();
    }
    let planned = marf(dir.path(), &["plan"]).exits(0);
    assert!(planned.stderr.contains("warning: run 1 "), "{}", planned.stderr);
    for verb in ["log", "run", "status"] {
        marf(dir.path(), &[verb]).exits(0);
    }
}

#[test]
fn what_no_kept_run_needs_is_collected_and_the_rest_is_whole() {
    let dir = pipeline();
    marf(dir.path(), &["run", "--set", "blur.min_share=0.9"]).exits(0);
    marf(dir.path(), &["run"]).exits(0);
    let gc = ["cache", "gc", "--keep-last", "1", "--grace", "0s"];
    let told = marf(dir.path(), &[&gc[..], &["--dry-run"]].concat()).exits(0);
    assert!(told.stdout.starts_with("would remove 1 run, "), "{}", told.stdout);
    marf(dir.path(), &["cache", "pin", "paper", "1"]).exits(0);
    let told = marf(dir.path(), &[&gc[..], &["--dry-run"]].concat()).exits(0);
    assert!(
        told.stdout.starts_with("would remove 0 runs, 0 records"),
        "{}",
        told.stdout
    );
    marf(dir.path(), &["cache", "unpin", "paper"]).exits(0);
    marf(dir.path(), &gc).exits(0);
    marf(dir.path(), &["cache", "fsck", "--read-data"]).exits(0);
    let ran = marf(dir.path(), &["run", "--json"]).exits(0);
    assert_eq!(ran.nodes("finished"), Vec::<String>::new());
    let again = marf(dir.path(), &["run", "--json", "--set", "blur.min_share=0.9"]).exits(0);
    assert!(
        again.nodes("finished").contains(&"blur".to_owned()),
        "it was collected"
    );
}

#[test]
fn damage_is_found_by_a_check_named_and_repaired() {
    let dir = common::ran("store", PIPELINE);
    let scene = output(dir.path(), "calibrate", "scene");
    damage(dir.path(), &scene);
    let found = marf(dir.path(), &["cache", "fsck", "--read-data"]).exits(1);
    assert!(found.stdout.contains(&scene[..8]), "{}", found.stdout);
    assert!(found.stderr.contains("--repair"), "{}", found.stderr);
    assert!(
        found.stdout.contains("  breaks a result of calibrate ("),
        "{}",
        found.stdout
    );
    marf(dir.path(), &["cache", "fsck", "--read-data", "--repair"]).exits(0);
    marf(dir.path(), &["cache", "fsck"]).exits(1);
    let collected = marf(dir.path(), &["cache", "gc", "--dry-run"]).exits(0).stderr;
    let missing = "the store lacks 1 object that kept runs need. A run computes what it reads again";
    assert!(collected.contains(missing), "{collected}");
    let ran = marf(dir.path(), &["run", "--json"]).exits(0);
    assert_eq!(ran.nodes("finished"), ["calibrate"]);
    marf(dir.path(), &["cache", "fsck", "--read-data"]).exits(0);
}

#[test]
fn bad_words_for_cache_verbs_are_refused_with_what_to_write() {
    let dir = pipeline();
    let none = marf(dir.path(), &["cache", "stat"]).exits(1);
    assert!(none.stderr.contains("there is no store"), "{}", none.stderr);
    marf(dir.path(), &["run", "--to", "extract"]).exits(0);
    for (args, words) in [
        (&["cache", "gc", "--max-size", "big"][..], "such as 20GB"),
        (&["cache", "gc", "--grace", "soon"], "such as 24h"),
        (&["cache", "pin", "../x"], "letters, digits"),
    ] {
        let refused = marf(dir.path(), args).exits(2);
        assert!(refused.stderr.contains(words), "{}", refused.stderr);
    }
    let refused = marf(dir.path(), &["cache", "pin", "x", "77"]).exits(1);
    assert!(
        refused.stderr.contains("there is no run 77"),
        "{}",
        refused.stderr
    );
    let refused = marf(dir.path(), &["cache", "unpin", "x"]).exits(1);
    assert!(refused.stderr.contains("unknown pin `x`"), "{}", refused.stderr);
}

/// Reads the folder of `common::photos`. Its photos are too small for the other nodes.
fn folder_pipeline(dir: &Path, keep: &str) {
    let text = format!(
        "name = \"kept\"\n[archive.photos]\nkind = \"folder\"\npath = \"photos\"\nkeep = \"{keep}\"\n\
         [node.extract]\narchive = \"photos\"\n[node.blur]\ninput = \"extract\"\n"
    );
    std::fs::write(dir.join("pipeline.toml"), text).unwrap();
}

fn stat(dir: &Path) -> serde_json::Value {
    let stat = marf(dir, &["cache", "stat", "--json"]).exits(0);
    serde_json::from_str(&stat.stdout).unwrap()
}

#[test]
fn photos_may_stay_outside_the_store_with_equal_results_and_an_edited_one_is_read_again() {
    let (copied, referenced) = (photos(), photos());
    folder_pipeline(copied.path(), "copy");
    folder_pipeline(referenced.path(), "reference");
    let run = |dir: &Path| marf(dir, &["run"]).exits(0);
    let set = |dir: &Path| output(dir, "blur", "photos");
    run(copied.path());
    run(referenced.path());
    assert_eq!(set(copied.path()), set(referenced.path()));
    assert_eq!(stat(copied.path())["references"], 0);
    // Four photos, and their cameras.
    assert_eq!(stat(referenced.path())["references"], 5);
    marf(referenced.path(), &["cache", "fsck", "--read-data"]).exits(0);
    // An edit is a fault of the store, until the run that reads the folder takes it for what it is: another photo.
    let folder = |dir: &Path| dir.join("photos/images");
    let edited = image::RgbImage::from_pixel(32, 24, image::Rgb([9, 90, 200]));
    for dir in [copied.path(), referenced.path()] {
        std::fs::remove_file(folder(dir).join("1.png")).unwrap();
        edited.save(folder(dir).join("1.png")).unwrap();
    }
    let fsck = marf(referenced.path(), &["cache", "fsck", "--read-data"]).exits(1);
    assert!(
        fsck.stdout.contains("do not have their digest"),
        "{}",
        fsck.stdout
    );
    run(copied.path());
    run(referenced.path());
    assert_eq!(set(copied.path()), set(referenced.path()));
    // A deleted photo is not in the set, and not an error.
    for dir in [copied.path(), referenced.path()] {
        std::fs::remove_file(folder(dir).join("2.png")).unwrap();
        run(dir);
    }
    assert_eq!(set(copied.path()), set(referenced.path()));
}

#[test]
fn a_whole_store_lacks_nothing_that_a_collection_warns_of() {
    let dir = pipeline();
    marf(dir.path(), &["run"]).exits(0);
    let collected = marf(dir.path(), &["cache", "gc", "--dry-run"]).exits(0);
    assert!(!collected.stderr.contains("missing"), "{}", collected.stderr);
}

/// The signal of the limit ends a program that does not expect it.
#[cfg(unix)]
#[test]
fn a_limit_on_the_size_of_files_is_an_error_that_names_the_file() {
    let dir = pipeline();
    let limited = std::process::Command::new("sh")
        .args([
            "-c",
            "ulimit -f 20; exec \"$@\"",
            "sh",
            env!("CARGO_BIN_EXE_marf"),
            "run",
        ])
        .current_dir(dir.path())
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&limited.stderr);
    assert_eq!(limited.status.code(), Some(1), "{stderr}");
    let named = stderr
        .lines()
        .any(|line| line.contains("cannot write `") && line.contains("File too large"));
    assert!(named, "{stderr}");
    marf(dir.path(), &["run"]).exits(0);
}

#[test]
fn only_a_value_that_changed_is_a_change() {
    let dir = pipeline();
    marf(dir.path(), &["run"]).exits(0);
    let why = |value: &str| {
        let text = marf(dir.path(), &["why", "blur", "--set", value]).exits(0).stdout;
        text.matches("\n  params.").count()
    };
    for own in [
        "blur.min_share=0.55",
        "blur.floor_ratio=3",
        "blur.floor_ratio=3.0",
    ] {
        assert_eq!(why(own), 0, "{own}");
    }
    assert_eq!(why("blur.min_share=0.6"), 1);
}

/// A record and a report name no folder of the machine.
#[test]
fn absolute_paths_are_recorded_from_the_folder_of_the_pipeline() {
    let dir = pipeline();
    let here = dir.path().canonicalize().unwrap();
    let (file, crate_dir) = (here.join("pipeline.toml"), here.join("crate"));
    marf(dir.path(), &["run", "--file", file.to_str().unwrap()]).exits(0);
    marf(dir.path(), &["export", "crate", crate_dir.to_str().unwrap()]).exits(0);
    for entry in walkdir::WalkDir::new(&crate_dir) {
        let entry = entry.unwrap();
        if entry.file_type().is_file() {
            let bytes = std::fs::read(entry.path()).unwrap();
            let text = String::from_utf8_lossy(&bytes);
            assert!(
                !text.contains(here.to_str().unwrap()),
                "{}",
                entry.path().display()
            );
        }
    }
}

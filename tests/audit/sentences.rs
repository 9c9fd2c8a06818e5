//! The first line of `audit`, `verify` and `replay`: an answer for people who do not know marf.

use std::path::Path;

use marf_export::iso_time;
use serde_json::Value;

use super::common::{copy, marf};
use super::{audit, ran};

const PROGRAM: &str = concat!("marf ", env!("CARGO_PKG_VERSION"));

/// Returns the first line, after the exit code was checked.
fn first_line(folder: &Path, args: &[&str], code: i32) -> String {
    let told = marf(folder, args).exits(code).stdout;
    told.lines().next().unwrap_or_default().to_owned()
}

/// Returns `marf 0.2.0 on 2026-11-27`, by the run that made a file.
fn program_and_date(folder: &Path, file: &str) -> String {
    let told = audit(folder, file, &[], 0);
    let started = told["lineage"][0]["started_unix_s"].as_u64().unwrap();
    format!("{PROGRAM} on {}", &iso_time(started)[..10])
}

/// Returns `32 of 34 photos`, by the fields of `--json`, and checks the second number.
fn photos_of(folder: &Path, file: &str) -> String {
    let told = audit(folder, file, &["--all"], 0);
    let lineage = &told["lineage"][0];
    let (used, read) = (&lineage["photos"]["used"], &lineage["photos"]["read"]);
    let listed = lineage["sources"][0]["listed"].as_array().unwrap().len();
    assert_eq!(read.as_u64(), Some(listed as u64));
    assert_eq!(lineage["photos"]["sols"], serde_json::json!([1]));
    if used == read {
        format!("{read} photos")
    } else {
        format!("{used} of {read} photos")
    }
}

#[test]
fn an_audit_begins_with_the_answer_and_is_short() {
    let dir = ran();
    let folder = dir.path();
    let by = program_and_date(folder, "out/report.html");
    let from = format!("{} of sol 1", photos_of(folder, "out/train/metrics.json"));
    for (file, said) in [
        (
            "out/train/weights.safetensors",
            format!("This trained field was computed by {by} from {from}. Its bytes are intact."),
        ),
        (
            "out/train/metrics.json",
            format!("This file was computed by {by} from {from}. Its bytes are intact."),
        ),
        (
            "out/report.html",
            format!("This report is a record of a run by {by} on {from}. Its bytes are intact."),
        ),
    ] {
        let told = marf(folder, &["audit", file]).exits(0).stdout;
        assert_eq!(told.lines().next().unwrap(), said);
        assert!(told.lines().count() <= 20, "{told}");
    }
    let all = "All bytes are intact, those of the file and of everything that it was made from.";
    assert_eq!(
        first_line(folder, &["audit", "out/train/metrics.json", "--verify"], 0),
        format!("This file was computed by {by} from {from}. {all}")
    );
    // Below the answer: which run, which command and which program.
    let told = marf(folder, &["audit", "out/train/metrics.json"]).exits(0).stdout;
    let json = audit(folder, "out/train/metrics.json", &[], 0);
    let made = &json["lineage"][0];
    let text = |value: &Value| value.as_str().unwrap_or("unknown").to_owned();
    let build = &made["build"];
    let started = iso_time(made["started_unix_s"].as_u64().unwrap());
    for line in [
        format!(
            "  made in run {} of {started}: {}",
            made["run"],
            text(&made["command"])
        ),
        format!(
            "  by {PROGRAM}, commit {}, {} {}, program file {}",
            text(&build["commit"]),
            text(&build["os"]),
            text(&build["arch"]),
            &text(&build["blake3"])[..12]
        ),
        "`--all` lists every input, product and digest".to_owned(),
    ] {
        assert!(told.lines().any(|found| found == line), "{line}\n{told}");
    }
    let listed = marf(folder, &["audit", "out/train/metrics.json", "--all"])
        .exits(0)
        .stdout;
    let all = audit(folder, "out/train/metrics.json", &["--all"], 0);
    for product in all["lineage"][0]["sources"][0]["listed"].as_array().unwrap() {
        let (id, digest) = (text(&product["id"]), text(&product["blobs"]["image"]));
        assert!(listed.contains(&id) && listed.contains(&digest), "{id}: {listed}");
    }
    // The same facts are fields.
    let json = audit(folder, "out/train/metrics.json", &[], 0);
    assert_eq!(json["answer"], "whole");
    assert_eq!(json["lineage"][0]["program"], PROGRAM);
}

#[test]
fn an_audit_of_an_altered_an_unknown_and_a_foreign_file_says_so_first() {
    let dir = ran();
    let folder = dir.path();
    let by = program_and_date(folder, "out/train/metrics.json");
    let path = folder.join("out/train/weights.safetensors");
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(folder.join("mailed"), bytes).unwrap();
    let from = photos_of(folder, "out/train/metrics.json");
    let said = first_line(folder, &["audit", "mailed"], 4);
    let start = format!(
        "This file was altered: it resembles a result of this store, but has other bytes. The closest original is a trained field that \
         was computed by {by} from {from} of sol 1. 9"
    );
    assert!(said.starts_with(&start), "{said}");
    assert!(said.ends_with(" % of the bytes are the same."), "{said}");
    std::fs::write(folder.join("mine.txt"), "nothing of yours").unwrap();
    assert_eq!(
        first_line(folder, &["audit", "mine.txt"], 3),
        "marf does not know this file: no run of this store made or read it."
    );
    let told = marf(folder, &["audit", "mine.txt"]).exits(3).stderr;
    assert!(told.contains("mine.txt is not a file of this store"), "{told}");
    let told = marf(folder, &["audit", "out"]).exits(2).stderr;
    assert_eq!(
        told,
        "error: out is a folder, and `audit` traces one file\n  hint: name a file in it. `marf verify out` checks the folder of a crate\n"
    );
}

#[test]
fn an_audit_of_a_photo_says_that_it_was_read() {
    let dir = tempfile::tempdir().unwrap();
    let photos = super::common::photos();
    copy(&photos.path().join("photos"), &dir.path().join("photos"));
    marf(dir.path(), &["filter", "photos"]).exits(0);
    let by = program_and_date(dir.path(), "photos/images/2.png");
    assert_eq!(
        first_line(dir.path(), &["audit", "photos/images/2.png"], 0),
        format!("This photo was read by {by}. It is part of 1 run. Its bytes are intact.")
    );
    let json = audit(dir.path(), "photos/images/2.png", &[], 0);
    let nodes = json["uses"]["runs"][0]["nodes"].as_array().unwrap().len();
    let told = marf(dir.path(), &["audit", "photos/images/2.png"])
        .exits(0)
        .stdout;
    let line = format!(
        "  used by {} of run 1",
        marf_progress::format::count(nodes, "node")
    );
    assert!(
        nodes > 0 && told.lines().any(|found| found == line),
        "{line}\n{told}"
    );
}

#[test]
fn a_crate_is_answered_for_in_the_first_line() {
    let dir = ran();
    let folder = dir.path();
    for (file, text) in [
        ("key.pem", PRIVATE_PEM),
        ("pub.pem", PUBLIC_PEM),
        ("other.pem", OTHER_PUBLIC_PEM),
    ] {
        std::fs::write(folder.join(file), text).unwrap();
    }
    marf(folder, &["export", "crate", "plain"]).exits(0);
    marf(folder, &["export", "crate", "signed", "--key", "key.pem"]).exits(0);
    let from = photos_of(folder, "out/train/metrics.json");
    let read = from.split(' ').rev().nth(1).unwrap();
    let files = |name: &str| {
        let json = marf(folder, &["verify", name, "--json"]).exits(0).stdout;
        serde_json::from_str::<Value>(&json).unwrap()["files"].clone()
    };
    let intact = |name: &str| {
        let files = files(name);
        format!(
            "This crate is intact: all {files} files of its data have the listed bytes, and it traces {read} photos to files of the archive."
        )
    };
    for (args, code, said) in [
        (
            &["plain"][..],
            0,
            "It is not signed, so it does not show who made it.",
        ),
        (
            &["plain", "--key", "pub.pem"],
            13,
            "But it is not signed, so the given key cannot show who made it.",
        ),
        (
            &["signed"],
            0,
            "It is signed. To check who made it, name the author's public key with --key.",
        ),
        (
            &["signed", "--key", "pub.pem"],
            0,
            "It is signed with the given key.",
        ),
        (
            &["signed", "--key", "other.pem"],
            13,
            "But it is signed with another key than the given one.",
        ),
    ] {
        let line = first_line(folder, &[&["verify"][..], args].concat(), code);
        assert_eq!(line, format!("{} {said}", intact(args[0])));
    }
    let by = program_and_date(folder, "out/train/metrics.json");
    assert_eq!(
        first_line(
            folder,
            &["audit", "out/train/metrics.json", "--crate", "plain"],
            0
        ),
        format!(
            "This file was computed by {by} from {from}. All bytes of the file and of the crate are intact."
        )
    );
    let text = folder.join("signed/data/pipeline.toml");
    std::fs::write(&text, std::fs::read_to_string(&text).unwrap().replace('2', "3")).unwrap();
    for key in [&[][..], &["--key", "pub.pem"], &["--key", "other.pem"]] {
        let line = first_line(folder, &[&["verify", "signed"][..], key].concat(), 4);
        assert!(
            line.starts_with("This crate is not intact: it was altered or damaged ("),
            "{line}"
        );
        assert!(line.ends_with(" faults). Do not trust it."), "{line}");
    }
    marf(
        folder,
        &[
            "export",
            "attest",
            "--key",
            "key.pem",
            "--out",
            "train.json",
            "train",
        ],
    )
    .exits(0);
    let said = first_line(folder, &["verify", "train.json", "--key", "pub.pem"], 0);
    assert!(
        said.starts_with("This statement is signed with the given key and covers "),
        "{said}"
    );
    marf(folder, &["verify", "train.json", "--key", "other.pem"]).exits(13);
    let told = marf(folder, &["verify", "pipeline.toml"]).exits(2).stderr;
    assert_eq!(
        told,
        "error: pipeline.toml is neither the folder of a crate nor a signed statement\n  hint: `verify` checks what `export crate` or \
         `export attest` wrote. `marf audit pipeline.toml` traces any other file\n"
    );
}

/// Test 1 of RFC 8032, section 7.1.
const PRIVATE_PEM: &str = "-----BEGIN PRIVATE KEY-----\n\
    MC4CAQAwBQYDK2VwBCIEIJ1hsZ3v/VpguoRK9JLsLMREScVpezJpGXA7rAMcrn9g\n\
    -----END PRIVATE KEY-----\n";
const PUBLIC_PEM: &str = "-----BEGIN PUBLIC KEY-----\n\
    MCowBQYDK2VwAyEA11qYAYKxCrfVS/7TyWQHOg7hcvPapiMlrwIaaPcHURo=\n\
    -----END PUBLIC KEY-----\n";
/// Test 2 of the same section.
const OTHER_PUBLIC_PEM: &str = "-----BEGIN PUBLIC KEY-----\n\
    MCowBQYDK2VwAyEAPUAXw+hDiVqStwqnTRt+vJyYLM8uxJaMwM1V8Sr0Zgw=\n\
    -----END PUBLIC KEY-----\n";

//! What is refused has the numbers and names that make the sentence true, and the way out that it names works.

use std::path::Path;

use serde_json::Value;

use super::common::marf;
use super::{SMALL, after_a_run, with_pipeline};

/// Runs a command that fails and compares what it prints with sentences.
#[track_caller]
fn refused(dir: &Path, line: &str, code: i32, sentences: &[&str]) {
    let args: Vec<&str> = line.split(' ').collect();
    let said = marf(dir, &args).exits(code).stderr;
    for sentence in sentences {
        assert!(said.contains(sentence), "`{sentence}` is not in\n{said}");
    }
}

#[test]
fn a_run_that_cannot_be_taken_is_named_with_those_that_can() {
    let absent = "name = \"absent\"\n[archive.mine]\nkind = \"folder\"\npath = \"photos\"\n[node.extract]\narchive = \"mine\"\n";
    let dir = with_pipeline(absent);
    marf(dir.path(), &["run"]).exits(1);
    let sentences = [
        "run 1 and those before it have no result",
        "`marf status` shows why",
    ];
    refused(dir.path(), "export crate crate", 1, &sentences);
    let named = marf(dir.path(), &["export", "crate", "crate", "--run", "1"]).stderr;
    assert!(
        named.contains("did not end with a result for every node (failed)"),
        "{named}"
    );
    // The status names the fault, as the hint says.
    let status = marf(dir.path(), &["status"]).exits(0).stdout;
    assert!(status.contains("failed"), "{status}");

    let dir = after_a_run();
    let dir = dir.path();
    marf(dir, &["run", "--to", "size"]).exits(0);
    let taken = marf(dir, &["export", "crate", "crate"]).exits(0).stderr;
    assert!(
        taken.contains("using run 1. Run 2 is newer and is of a part: name it to use it"),
        "{taken}"
    );
    marf(dir, &["export", "crate", "named", "--run", "1"]).exits(0);
    let sentences = [
        "run 2 has placed no photos, or more than once",
        "one node `calibrate`",
    ];
    refused(dir, "compare --sols 1 --sols 2 --out maps --run 2", 2, &sentences);
    refused(
        dir,
        "export mesh nothing --out a.ply --run 1",
        2,
        &[
            "run 1 has no result of a node `nothing`",
            "its nodes are extract, size, shape. Name one of these",
        ],
    );
    std::fs::write(dir.join("pipeline.toml"), SMALL.replace("\"small\"", "\"other\"")).unwrap();
    let sentences = [
        "there is no run yet",
        "`marf run` makes one. `marf log` lists all",
    ];
    refused(dir, "export crate other", 1, &sentences);
    let log = marf(dir, &["log"]).exits(0).stdout;
    assert_eq!(log.lines().count(), 2, "runs of all pipelines: {log}");
}

#[test]
fn words_that_are_not_what_a_verb_takes_are_named() {
    let dir = after_a_run();
    let dir = dir.path();
    for share in ["0%", "101%", "5", "-1%"] {
        let line = format!("cache fsck --read-data={share}");
        refused(
            dir,
            &line,
            2,
            &["write a share above 0% and up to 100%, such as 5%"],
        );
    }
    marf(dir, &["cache", "fsck", "--read-data=5%"]).exits(0);
    std::fs::write(dir.join("a.png"), b"x").unwrap();
    let sentences = ["`a.png` is a file, not a folder", "set DIR to its folder"];
    refused(dir, "filter a.png", 1, &sentences);
    marf(dir, &["key", "new", "--out", "own.pem"]).exits(0);
    let kept = std::fs::read(dir.join("own.pem")).unwrap();
    let sentences = ["the key own.pem cannot be written: ", "A key is never replaced"];
    refused(dir, "key new --out own.pem", 1, &sentences);
    assert_eq!(std::fs::read(dir.join("own.pem")).unwrap(), kept);
    let pins = dir.join(".marf/pins");
    std::fs::create_dir_all(&pins).unwrap();
    std::fs::write(pins.join("paper"), "the first").unwrap();
    let sentences = [
        "paper names no run",
        "write it again with `marf cache pin paper RUN`",
    ];
    refused(dir, "cache gc --dry-run", 1, &sentences);
    marf(dir, &["cache", "pin", "paper", "1"]).exits(0);
    marf(dir, &["cache", "gc", "--dry-run"]).exits(0);
}

#[test]
fn a_run_that_a_shared_store_lacks_is_refused_with_those_that_it_has() {
    let dir = after_a_run();
    let dir = dir.path();
    let url = format!("file://{}", dir.join("shared").display());
    let pushed = marf(dir, &["cache", "push", "--remote", &url, "--json"])
        .exits(0)
        .stdout;
    let pushed: Value = serde_json::from_str(&pushed).unwrap();
    let short = &pushed["run"].as_str().unwrap()[..12];
    let way_out = format!("name one with --run. The newest of all pipelines are {short}");
    std::fs::write(dir.join("pipeline.toml"), SMALL.replace("\"small\"", "\"other\"")).unwrap();
    let line = format!("cache pull --remote {url}");
    refused(dir, &line, 1, &["no run of the pipeline `other`", &way_out]);
    marf(dir, &["cache", "pull", "--remote", &url, "--run", short]).exits(0);
}

/// Many names have one line with their number.
#[test]
fn names_of_files_that_gave_no_photo_are_counted() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    std::fs::create_dir(&folder).unwrap();
    let picture =
        image::RgbImage::from_fn(64, 48, |x, y| image::Rgb([x as u8, y as u8, (x * y % 251) as u8]));
    picture.save(folder.join("photo.png")).unwrap();
    let mut args = vec!["filter".to_owned(), "photos".to_owned()];
    for index in 10..21 {
        let name = format!("page{index}.jpg");
        std::fs::write(folder.join(&name), b"<html>").unwrap();
        args.extend(["--reject".to_owned(), name]);
    }
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let said = marf(dir.path(), &args).exits(0).stderr;
    assert!(
        said.contains("[reject] 11 names gave no photo, the first is `page10.jpg`"),
        "{said}"
    );
}

#[test]
fn a_number_or_a_sol_beyond_the_last_is_refused_and_the_last_is_taken() {
    let size = |bytes: &str| SMALL.replace("min_bytes = 2_000", &format!("min_bytes = {bytes}"));
    let dir = with_pipeline(&size("99999999999999999999"));
    refused(
        dir.path(),
        "plan",
        2,
        &["`99999999999999999999` does not fit 64 bits"],
    );
    let dir = with_pipeline(&size("9223372036854775807"));
    marf(dir.path(), &["plan"]).exits(0);
    let blur = |share: &str| format!("{SMALL}[node.blur]\ninput = \"shape\"\nmin_share = {share}\n");
    let dir = with_pipeline(&blur("1.5"));
    refused(dir.path(), "plan", 2, &["1.5 is not in [0, 1]"]);
    let dir = with_pipeline(&blur("1.0"));
    marf(dir.path(), &["plan"]).exits(0);
    let dir = with_pipeline(SMALL);
    let args = ["plan", "--set", "archive.demo.sols=9999"];
    let said = marf(dir.path(), &args).stderr;
    let range = said
        .split_once("the demo has sols ")
        .unwrap_or_else(|| panic!("{said}"))
        .1;
    let words: Vec<&str> = range
        .split(|letter: char| !letter.is_ascii_alphanumeric())
        .collect();
    let (first, last): (u32, u32) = (words[0].parse().unwrap(), words[2].parse().unwrap());
    for sol in [first, last] {
        let set = format!("archive.demo.sols={sol}");
        marf(dir.path(), &["plan", "--set", &set]).exits(0);
    }
    let set = format!("archive.demo.sols={}", last + 1);
    assert_ne!(marf(dir.path(), &["plan", "--set", &set]).code, 0, "{set}");
}

#[test]
fn a_template_is_what_it_is_said_to_be() {
    let dir = tempfile::tempdir().unwrap();
    let said = marf(dir.path(), &["init", "--mission", "perseverance"])
        .exits(0)
        .stderr;
    assert!(
        said.contains("Mastcam-Z of Mars 2020, from the Planetary Data System"),
        "{said}"
    );
    let text = std::fs::read_to_string(dir.path().join("pipeline.toml")).unwrap();
    let file: toml::Value = toml::from_str(&text).unwrap();
    let archives = file["archive"].as_table().unwrap();
    let (_, archive) = archives.iter().next().unwrap();
    for (key, value) in [
        ("kind", "pds"),
        ("mission", "perseverance"),
        ("instrument", "mastcam-z"),
    ] {
        assert_eq!(archive[key].as_str(), Some(value), "{key}");
    }
}

//! `marf filter` and the lists of a person, end to end.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod common;
#[path = "../stages/filter/tests/common/pictures.rs"]
mod pictures;

use std::path::Path;

use common::marf;
use image::ImageFormat;
use pictures::{dynamic, encoded, ground, png};

/// Six places, a copy, a gray photo and a text that claims to be a photo.
fn photos() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| std::fs::write(dir.path().join(name), bytes).unwrap();
    for seed in 0..6 {
        write(&format!("place_{seed}.png"), &png(&ground(seed)));
    }
    write("copy.png", &png(&ground(3)));
    let gray = dynamic(&ground(9)).to_luma8().into();
    write("gray.png", &encoded(&gray, ImageFormat::Png));
    write("page.jpg", b"<html>404</html>");
    dir
}

/// File, verdict and reason of every line of a CSV.
fn csv(path: &Path) -> Vec<(String, String, String)> {
    let mut reader = csv::Reader::from_path(path).unwrap();
    let heads = ["file", "verdict", "score", "threshold", "twin", "reason"];
    assert_eq!(reader.headers().unwrap(), heads.as_slice());
    let field = |line: &csv::StringRecord, at: usize| line[at].to_owned();
    reader
        .records()
        .map(|line| line.unwrap())
        .map(|line| (field(&line, 0), field(&line, 1), field(&line, 5)))
        .collect()
}

fn verdict<'a>(lines: &'a [(String, String, String)], file: &str) -> &'a (String, String, String) {
    lines
        .iter()
        .find(|line| line.0 == file)
        .unwrap_or_else(|| panic!("{file} is missing"))
}

#[test]
fn every_file_has_a_verdict_whatever_the_threads_and_a_new_threshold_decodes_nothing() {
    let dir = photos();
    let work = tempfile::tempdir().unwrap();
    let run = |out: &str, more: &[&str]| {
        let folder = dir.path().to_string_lossy().into_owned();
        let args: Vec<&str> = ["filter", &folder, "--out", out]
            .into_iter()
            .chain(more.iter().copied())
            .collect();
        let ran = marf(work.path(), &args).exits(0);
        (csv(&work.path().join(out)), ran.stderr)
    };
    let (lines, first) = run("one.csv", &["--threads", "1", "--store", "a"]);
    assert_eq!(lines.len(), 9);
    assert_eq!(verdict(&lines, "page.jpg").1, "decode");
    assert_eq!(verdict(&lines, "gray.png").1, "grayscale");
    let pair = ["copy.png", "place_3.png"].map(|file| verdict(&lines, file).1.as_str());
    assert!(
        pair == ["keep", "duplicate"] || pair == ["duplicate", "keep"],
        "{pair:?}"
    );
    assert_eq!(
        lines.iter().filter(|line| line.1 == "keep").count(),
        6,
        "{lines:?}"
    );
    let (again, _) = run("two.csv", &["--threads", "4", "--store", "b"]);
    assert_eq!(lines, again);
    // Extract measures for all filters while it decodes.
    assert!(!first.contains("measured"), "{first}");
    let (other, second) = run("three.csv", &["--store", "a", "--set", "grayscale.keep=all"]);
    assert_ne!(verdict(&other, "gray.png").1, "grayscale");
    assert!(!second.contains("measured"), "{second}");
    let page = std::fs::read_to_string(work.path().join("one.html")).unwrap();
    for text in [
        "How firm the verdicts are",
        "closest call",
        "Rejected photos",
        "data:image/jpeg",
    ] {
        assert!(page.contains(text), "{text}");
    }
    assert!(!page.contains("<script") && !page.contains("Tuning"));
}

#[test]
fn a_person_has_the_last_word_and_it_is_in_the_key() {
    let dir = photos();
    let path = dir.path().to_string_lossy().into_owned();
    let work = tempfile::tempdir().unwrap();
    let pipeline = |lists: &str| {
        let text = format!(
            "[archive.photos]\nkind = \"folder\"\npath = '{path}'\n[node.extract]\narchive = \"photos\"\n\
             [node.duplicate]\ninput = \"extract\"\n[node.grayscale]\ninput = \"duplicate\"\n{lists}"
        );
        std::fs::write(work.path().join("pipeline.toml"), text).unwrap();
    };
    pipeline("");
    marf(work.path(), &["run"]).exits(0);
    pipeline("[keep]\nids = [\"gray.png\"]\n[reject]\nids = [\"place_2.png\", \"palce_4.png\"]\n");
    let plan = marf(work.path(), &["plan"]).exits(0);
    let printed = format!("{}{}", plan.stdout, plan.stderr);
    assert!(printed.contains("by_hand"), "{printed}");
    let ran = marf(work.path(), &["run"]).exits(0);
    assert!(
        ran.stderr
            .contains("[reject] `palce_4.png` names no photo of this run: did you mean `place_4.png`?"),
        "{}",
        ran.stderr
    );
    let page = std::fs::read_to_string(work.path().join("out/report.html")).unwrap();
    assert!(
        page.contains("kept by hand, against the filter: one band"),
        "the page does not say who kept it"
    );
    assert!(page.contains("rejected by hand, against the filter"));
    let refused = marf(work.path(), &["run", "--set", "keep.id=[\"gray.png\"]"]).exits(2);
    assert!(
        refused.stderr.contains("did you mean `ids`?"),
        "{}",
        refused.stderr
    );
}

#[test]
fn lists_may_be_given_on_the_command_line() {
    let dir = photos();
    let work = tempfile::tempdir().unwrap();
    let folder = dir.path().to_string_lossy().into_owned();
    let args = ["filter", &folder, "--keep", "gray.png", "--reject", "place_0.png"];
    marf(work.path(), &args).exits(0);
    let lines = csv(&work.path().join("verdicts.csv"));
    let (gray, gone) = (verdict(&lines, "gray.png"), verdict(&lines, "place_0.png"));
    assert!(gray.1 == "keep" && gray.2.contains("kept by hand"), "{gray:?}");
    assert!(
        gone.1 != "keep" && gone.2.contains("rejected by hand"),
        "{gone:?}"
    );
}

#[test]
fn a_folder_without_a_photo_is_an_error_and_nothing_is_said_to_be_written() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("photos")).unwrap();
    // Cameras without photos: a folder without any file has an error of its own.
    std::fs::write(dir.path().join("photos/transforms.json"), "{}").unwrap();
    let ran = marf(dir.path(), &["filter", "photos", "--out", "verdicts.csv"]).exits(1);
    assert!(ran.stderr.contains("photos has no photo"), "{}", ran.stderr);
    assert!(
        !ran.stdout.contains("wrote") && !dir.path().join("verdicts.csv").exists(),
        "{}",
        ran.stdout
    );
}

/// Another folder of the same pipeline is neither the folder that was looked at before nor what its photos are compared with.
#[test]
fn a_run_on_another_folder_names_it_and_is_compared_with_runs_on_that_folder_alone() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, seed: u32| {
        let path = dir.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, png(&ground(seed))).unwrap();
    };
    (0..3).for_each(|seed| write(&format!("A/{seed}.png"), seed));
    (3..5).for_each(|seed| write(&format!("B/{seed}.png"), seed));
    let text = "[archive.a]\nkind = \"folder\"\npath = \"A\"\n[node.extract]\narchive = \"a\"\n[node.size]\ninput = \"extract\"\n";
    std::fs::write(dir.path().join("pipeline.toml"), text).unwrap();
    let section = || {
        let page = std::fs::read_to_string(dir.path().join("out/report.html")).unwrap();
        let start = page.find("<section id=\"changes\">").unwrap();
        page[start..][..page[start..].find("</section>").unwrap()].to_owned()
    };
    let on_b = ["run", "--set", "archive.a.path=\"B\""];
    marf(dir.path(), &["run"]).exits(0);
    let said = marf(dir.path(), &on_b).exits(0).stderr;
    assert!(said.contains("folder `B`: shard 0 changed"), "{said}");
    assert!(
        section().contains("No earlier run of this pipeline with the same archives"),
        "{}",
        section()
    );
    write("B/5.png", 5);
    marf(dir.path(), &on_b).exits(0);
    assert!(
        section().contains("Differs from run 2 in 2 nodes"),
        "{}",
        section()
    );
    assert!(section().contains("extract: 1 products in"), "{}", section());
}

//! Lines for people have the numbers of what was written, and those of `--json`.

use std::path::Path;

use marf_progress::format::{count, duration, size};
use serde_json::Value;

use crate::common::{marf, photos};
use crate::{after_a_run, with_pipeline};

/// What a verb prints for people and, called again, as JSON.
pub struct Printed {
    stdout: String,
    stderr: String,
    pub json: Value,
}

pub fn told(folder: &Path, line: &str) -> Printed {
    let args: Vec<&str> = line.split(' ').collect();
    let printed = marf(folder, &args).exits(0);
    let json = marf(folder, &[&args[..], &["--json"]].concat()).exits(0).stdout;
    Printed {
        stdout: printed.stdout,
        stderr: printed.stderr,
        json: serde_json::from_str(&json).unwrap(),
    }
}

impl Printed {
    #[track_caller]
    pub fn says(&self, expected: &str) {
        let has = self.stdout.lines().any(|line| line.contains(expected));
        assert!(has, "`{expected}` is not in\n{}", self.stdout);
    }

    #[track_caller]
    pub fn float(&self, pointer: &str) -> f64 {
        let value = self.json.pointer(pointer).and_then(Value::as_f64);
        value.unwrap_or_else(|| panic!("no {pointer} in {}", self.json))
    }

    #[track_caller]
    pub fn whole(&self, pointer: &str) -> usize {
        self.float(pointer) as usize
    }
}

pub fn bytes(folder: &Path, file: &str) -> Vec<u8> {
    std::fs::read(folder.join(file)).unwrap_or_else(|error| panic!("{file}: {error}"))
}

pub fn document(folder: &Path, file: &str) -> Value {
    serde_json::from_slice(&bytes(folder, file)).unwrap()
}

/// Returns the files below a folder and their bytes in all.
pub fn files(folder: &Path) -> (usize, u64) {
    let entries = walkdir::WalkDir::new(folder).into_iter().map(Result::unwrap);
    let files = entries.filter(|entry| entry.file_type().is_file());
    files.fold((0, 0), |(files, bytes), entry| {
        (files + 1, bytes + entry.metadata().unwrap().len())
    })
}

/// Returns how many of an element the header of a PLY file counts.
pub fn elements(ply: &[u8], of: &str) -> usize {
    let head = String::from_utf8_lossy(&ply[..4096.min(ply.len())]).into_owned();
    let line = head
        .lines()
        .find_map(|line| line.strip_prefix(&format!("element {of} ")));
    line.unwrap_or_else(|| panic!("no {of} in {head}"))
        .parse()
        .unwrap()
}

#[test]
fn verbs_on_a_folder_print_the_numbers_of_their_files() {
    let dir = photos();
    let dir = dir.path();
    let filter = told(dir, "filter photos");
    let verdicts = String::from_utf8(bytes(dir, "verdicts.csv")).unwrap();
    let mut reader = csv::Reader::from_reader(verdicts.as_bytes());
    let lines: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    let all = count(lines.len(), "file");
    for (name, number) in filter.json.as_object().unwrap() {
        let of_csv = lines.iter().filter(|line| &line[1] == name).count();
        assert_eq!(number.as_u64(), Some(of_csv as u64), "{name}: {verdicts}");
        filter.says(&format!("{name:<12} {of_csv} of {all}"));
    }
    // Every filter that compares a score with a threshold has a line for all its verdicts.
    let table: Vec<&str> = filter
        .stderr
        .lines()
        .filter(|line| line.ends_with(" verdicts change"))
        .collect();
    assert!(!table.is_empty(), "{}", filter.stderr);
    for line in table {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [counts @ .., "of", calls, "verdicts", "change"] = &words[1..] else {
            panic!("{line}");
        };
        let calls: usize = calls.parse().unwrap();
        assert!(calls <= lines.len(), "{line}");
        assert!(
            counts
                .iter()
                .all(|flips| flips.parse::<usize>().unwrap() <= calls),
            "{line}"
        );
    }

    let depth = told(dir, "depth photos --out depths --method import");
    let percent = |pointer: &str| format!("{:.1} %", 100.0 * depth.float(pointer));
    let refused: u64 = depth.json["refused"]
        .as_object()
        .unwrap()
        .values()
        .map(|of| of.as_u64().unwrap())
        .sum();
    let pairs = depth.json["pairs"].as_array().unwrap().iter();
    let matched = pairs.filter(|pair| pair["reason"].is_null()).count();
    let of_depths = depth.json["photos"].as_array().unwrap();
    let with_depth = of_depths
        .iter()
        .filter(|photo| photo["share"].as_f64().unwrap() > 0.0)
        .count();
    depth.says("4 of 4 photos placed");
    depth.says(&format!("{matched} matched, {refused} refused"));
    depth.says(&format!(
        "{} of the pixels, {} confirmed by two pairs",
        percent("/share"),
        percent("/confirmed_share")
    ));
    depth.says(&format!("{with_depth} of 4 photos have any"));
    if depth.float("/sky_share") > 0.0 {
        depth.says(&format!(
            "{} of the pixels, without a depth",
            percent("/sky_share")
        ));
    }
    let pictures = walkdir::WalkDir::new(dir.join("depths"))
        .into_iter()
        .map(Result::unwrap);
    let pictures = pictures.filter(|entry| entry.path().extension().is_some_and(|ending| ending == "png"));
    depth.says(&format!("{} pictures of photos below depths", pictures.count()));

    let fit = "fit photos --budget 1s --device cpu --set train.field.log2_table=10 --set train.field.batch_samples=1024";
    let fit = told(dir, fit);
    let of = |name: &str| fit.float(&format!("/1s/{name}"));
    fit.says(&format!(
        "PSNR {:.2} dB  SSIM {:.3}  {} steps in {}, {:.2} M samples/s, {} in all, {} expected",
        of("psnr"),
        of("ssim"),
        of("steps"),
        duration(of("train_seconds")),
        of("samples_per_s") / 1e6,
        duration(of("seconds")),
        duration(of("expected_seconds"))
    ));
    fit.says("1 of 1 held-out photos judged at 32 x 24 pixels. Photo and render side by side: ");
    assert!(
        dir.join("fit/1s/compared").is_dir(),
        "the pictures that the line names"
    );
    fit.says(&format!(
        "each of the 4 photos judged by a field trained without it, {} of {} steps: PSNR {:.2} dB",
        of("folds/steps"),
        of("folds/steps_of_whole"),
        of("folds/psnr")
    ));
    assert!(fit.stderr.contains("4 of 4 photos placed"), "{}", fit.stderr);
    let again = "fit photos --budget 1s --device cpu --set train.field.log2_table=10 --set train.field.batch_samples=1024 --memory 4GB";
    let again = marf(dir, &again.split(' ').collect::<Vec<_>>()).exits(0);
    assert!(
        !again.done().contains(&"train"),
        "4GB is the default: {}",
        again.stderr
    );
    // The way on is one that works: each of its commands finds this run.
    assert!(fit.stderr.contains("next: `marf view` shows the field in 3-D, `marf export mesh --out scene.glb` makes a mesh, `marf init --mission folder` writes a pipeline for photos that change"));
    marf(dir, &["report"]).exits(0);
    let mesh = marf(dir, &["export", "mesh", "--out", "scene.glb"]);
    assert!(
        mesh.code == 0 || mesh.stderr.contains("surface"),
        "{}",
        mesh.stderr
    );
}

#[test]
fn a_run_a_table_and_pages_print_what_they_count() {
    let dir = with_pipeline(crate::SMALL);
    let dir = dir.path();
    let first = marf(dir, &["run"]).exits(0).stdout;
    assert!(first.contains("\n3 of 3 nodes ran in "), "{first}");
    let again = marf(dir, &["run"]).exits(0).stdout;
    assert!(again.contains("\n0 of 3 nodes ran in "), "{again}");

    let photos = told(dir, "photos");
    let model = &photos.json["photos"][0]["prior"]["model"];
    let vector = |name: &str| -> [f64; 3] { serde_json::from_value(model[name].clone()).unwrap() };
    let (a, h, v) = (vector("a"), vector("h"), vector("v"));
    let dot = |x: [f64; 3], y: [f64; 3]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    // Part of H along A, and what is left of it across.
    let (hc, vc) = (dot(a, h), dot(a, v));
    let across = (dot(h, h) - hc * hc).sqrt();
    photos.says(&format!("{across:.1} px at ({hc:.0}, {vc:.0})"));

    let pages = marf(dir, &["man", "pages"]).exits(0).stdout;
    let (written, _) = files(&dir.join("pages"));
    assert_eq!(
        pages,
        format!("wrote {written} pages to pages: `man -l pages/marf.1` shows the first\n")
    );
    assert!(dir.join("pages/marf.1").is_file());

    let text = bytes(dir, "pipeline.toml");
    let there = marf(dir, &["init"]).exits(2).stderr;
    assert!(there.contains("pipeline.toml is there already"), "{there}");
    assert_eq!(bytes(dir, "pipeline.toml"), text, "it stays");
    std::fs::remove_file(dir.join("pipeline.toml")).unwrap();
    marf(dir, &["init"]).exits(0);
}

#[test]
fn verbs_of_the_store_print_the_numbers_of_their_json() {
    let dir = after_a_run();
    let dir = dir.path();
    marf(dir, &["run", "--set", "shape.min_width=121"]).exits(0);
    let pinned = marf(dir, &["cache", "pin", "paper", "1"]).exits(0).stdout;
    assert_eq!(pinned, "pinned run 1 as `paper`\n");
    marf(dir, &["cache", "unpin", "paper"]).exits(0);
    let gc = told(dir, "cache gc --keep-last 1 --grace 0s --dry-run");
    assert_eq!(gc.whole("/runs_removed"), 1);
    gc.says(&format!(
        "would remove 1 run, {} records, {} memos, {} blobs: {}, kept {}",
        gc.whole("/records"),
        gc.whole("/memos"),
        gc.whole("/loose_blobs") + gc.whole("/packed_blobs"),
        size((gc.whole("/loose_bytes") + gc.whole("/pack_bytes")) as u64),
        size(gc.whole("/kept_bytes") as u64)
    ));
    let fsck = told(dir, "cache fsck --read-data");
    let stat: Value = serde_json::from_str(&marf(dir, &["cache", "stat", "--json"]).exits(0).stdout).unwrap();
    assert_eq!(
        (fsck.whole("/runs"), &fsck.json["records"]),
        (2, &stat["records"]),
        "{stat}"
    );
    fsck.says(&format!(
        "{} blobs, {} records, {} memos, 2 runs, {} read, 0 faults",
        fsck.whole("/blobs"),
        fsck.whole("/records"),
        fsck.whole("/memos"),
        size(fsck.whole("/verified_bytes") as u64)
    ));
    assert!(fsck.whole("/verified_bytes") > 0);
}

#[test]
fn verbs_of_a_shared_store_print_the_numbers_of_their_json() {
    let world = tempfile::tempdir().unwrap();
    let url = format!("file://{}", world.path().join("shared").display());
    let other = format!("file://{}", world.path().join("other").display());
    let dir = after_a_run();
    let dir = dir.path();
    let pushed = marf(dir, &["cache", "push", "--remote", &url]).exits(0).stdout;
    let json = marf(dir, &["cache", "push", "--remote", &other, "--json"])
        .exits(0)
        .stdout;
    let json: Value = serde_json::from_str(&json).unwrap();
    let short = |json: &Value| json["run"].as_str().unwrap()[..12].to_owned();
    let bytes_of = |json: &Value| size(json["blob_bytes"].as_u64().unwrap());
    let line = format!(
        "pushed run 1 ({}): {} results (0 already there), {} blobs ({}), {} packs, ",
        short(&json),
        json["results"],
        json["blobs"],
        bytes_of(&json),
        json["packs"]
    );
    assert!(pushed.starts_with(&line), "{line}\n{pushed}");
    let again = marf(dir, &["cache", "push", "--remote", &url]).exits(0).stdout;
    // The results of its three nodes are there, so that nobody asks for their parts.
    let known = "0 results (3 already there), 0 blobs (0 bytes), 0 packs";
    assert!(again.contains(known), "{again}");

    let [there, elsewhere] = [with_pipeline(crate::SMALL), with_pipeline(crate::SMALL)];
    let pulled = marf(there.path(), &["cache", "pull", "--remote", &url])
        .exits(0)
        .stdout;
    let json = marf(elsewhere.path(), &["cache", "pull", "--remote", &url, "--json"])
        .exits(0)
        .stdout;
    let json: Value = serde_json::from_str(&json).unwrap();
    let line = format!(
        "pulled run {} of `small` as run 1: {} results (0 already here), {} blobs ({}), ",
        short(&json),
        json["results"],
        json["blobs"],
        bytes_of(&json)
    );
    assert!(pulled.starts_with(&line), "{line}\n{pulled}");

    let fsck = told(dir, &format!("cache fsck --read-data --remote {url}"));
    assert_eq!(fsck.whole("/runs"), 1);
    fsck.says(&format!(
        "{} blobs, {} records, 1 run, {} read, 0 faults",
        fsck.whole("/blobs"),
        fsck.whole("/records"),
        size(fsck.whole("/read_bytes") as u64)
    ));
    marf(dir, &["run", "--set", "shape.min_width=121"]).exits(0);
    marf(dir, &["cache", "push", "--remote", &url]).exits(0);
    let gc = told(
        dir,
        &format!("cache gc --keep-last 1 --grace 0s --dry-run --remote {url}"),
    );
    let of = |name: &str| gc.whole(&format!("/collected/{name}"));
    assert_eq!(of("runs"), 1);
    gc.says(&format!(
        "would remove 1 run, {} records, {} large blobs, {} packs: {}, kept {} ({} packs rewritten), ",
        of("records"),
        of("blobs"),
        of("packs"),
        size(of("removed_bytes") as u64),
        size(of("kept_bytes") as u64),
        of("new_packs")
    ));
}

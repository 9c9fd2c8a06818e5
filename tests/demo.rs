//! The whole pipeline on the built-in Mars, small: which nodes run when, and the same bytes for any threads.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod common;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::LazyLock;

use common::{Ran, SMALL_DEMO, copy, marf};

fn run(folder: &Path, more: &[&str]) -> Ran {
    let mut args = vec!["run", "--json"];
    args.extend(SMALL_DEMO.iter().flat_map(|set| ["--set", set]));
    args.extend(more);
    marf(folder, &args).exits(0)
}

fn demo() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    marf(dir.path(), &["init"]).exits(0);
    dir
}

/// A copy of a folder in which the demo has run once, by two threads, and what that run printed.
fn ran() -> (tempfile::TempDir, &'static Ran) {
    static RUN: LazyLock<(tempfile::TempDir, Ran)> = LazyLock::new(|| {
        let dir = demo();
        let first = run(dir.path(), &["--threads", "2"]);
        (dir, first)
    });
    let dir = tempfile::tempdir().unwrap();
    copy(RUN.0.path(), dir.path());
    (dir, &RUN.1)
}

/// Digests of all outputs of the last run, by node and name.
fn digests(folder: &Path) -> BTreeMap<String, String> {
    let status: serde_json::Value =
        serde_json::from_str(&marf(folder, &["status", "--json"]).exits(0).stdout).unwrap();
    let mut found = BTreeMap::new();
    for node in status["nodes"].as_array().unwrap() {
        for (name, output) in node["outputs"].as_object().unwrap() {
            let key = format!("{} {name}", node["name"].as_str().unwrap());
            found.insert(key, output["digest"].as_str().unwrap().to_owned());
        }
    }
    found
}

fn count(ran: &Ran, node: &str, what: &str) -> u64 {
    let events = ran.events();
    let finished = events
        .iter()
        .find(|event| event["event"] == "finished" && event["node"] == node);
    finished.unwrap_or_else(|| panic!("{node} did not run"))["counts"][what]
        .as_u64()
        .unwrap_or(0)
}

/// Returns the numbers of a page right after a text.
fn numbers(page: &str, before: &str) -> Vec<f64> {
    let after = page.split(before).skip(1);
    let digits = after.map(|rest| {
        let is_of_number = |letter: char| letter.is_ascii_digit() || ",.-".contains(letter);
        let end = rest.find(|letter| !is_of_number(letter)).unwrap_or(rest.len());
        rest[..end].trim_end_matches(['.', ',']).replace(',', "")
    });
    digits.filter_map(|digits| digits.parse().ok()).collect()
}

/// Compares the numbers of a report that stand at several places.
fn numbers_that_stand_twice_agree(page: &str) {
    let first = |before: &str| {
        let found = numbers(page, before);
        *found
            .first()
            .unwrap_or_else(|| panic!("no number after `{before}`"))
    };
    let cell = |key: &str| first(&format!("<th scope=\"row\">{key}</th><td class=\"number\">"));
    let figure = |name: &str| first(&format!("<dt>{name}</dt><dd>"));
    let rows = page.matches("<td class=\"who\">").count() as f64;
    assert_eq!(
        [first("<p class=\"quiet work\">"), first("Graph of ")],
        [rows; 2],
        "nodes"
    );

    // Each filter gets what the one before it kept, and the galleries show as many as the funnel counts.
    let bars: Vec<&str> = page
        .split("<svg class=\"funnel\"")
        .nth(1)
        .unwrap()
        .split("</svg>")
        .next()
        .unwrap()
        .split("<title>")
        .skip(1)
        .collect();
    let mut given = None;
    for bar in bars {
        let (name, counts) = bar.split_once(": ").unwrap();
        let seen = numbers(&format!("={counts}"), "=")[0];
        let kept = numbers(counts, "in, ").first().copied().unwrap_or(seen);
        let rejected = numbers(counts, "kept, ").first().copied().unwrap_or(0.0);
        assert_eq!(seen, kept + rejected, "{name}");
        assert!(
            given.is_none_or(|given| given == seen),
            "{name}: {given:?} and {seen}"
        );
        if rejected > 0.0 && given.is_some() {
            let gallery = format!("<h3>{name}: ");
            assert_eq!((first(&gallery), name), (rejected, name));
        }
        given = Some(kept);
    }
    let kept = given.unwrap();
    let gallery = page.split("<section id=\"kept\">").nth(1).unwrap();
    assert_eq!(numbers(gallery, "<p>")[0], kept, "photos kept");
    assert_eq!(cell("totals.photos"), kept, "photos that calibration was given");

    let cameras = page.split("<section id=\"cameras\">").nth(1).unwrap();
    let [placed, held_out] = ["</h3><p>", "cameras, "].map(|before| numbers(cameras, before)[0]);
    assert_eq!(
        [figure("photos placed"), cell("totals.registered")],
        [placed; 2],
        "placed"
    );
    let training = [
        figure("photos held out"),
        cell("held_out_photos"),
        cell("totals.held_out"),
    ];
    assert_eq!(training, [held_out; 3], "held out");
    assert_eq!(
        figure("photos trained on") + held_out,
        placed,
        "trained on and held out"
    );
    for (name, key) in [("PSNR", "psnr"), ("SSIM", "ssim")] {
        assert_eq!(figure(name), cell(key), "{name}");
    }
}

#[test]
fn only_what_changed_runs_again() {
    let (dir, first) = ran();
    assert_eq!(first.nodes("failed"), Vec::<String>::new());
    let events = first.events();
    let at = |event: &str, node: &str| {
        let is_it = |found: &serde_json::Value| {
            found["event"] == event && found["node"].as_str().is_some_and(|name| name.starts_with(node))
        };
        events
            .iter()
            .position(is_it)
            .unwrap_or_else(|| panic!("{event} {node}"))
    };
    assert!(
        at("finished", "draft") < at("will_run", "tune/"),
        "the draft comes before the trials"
    );
    let kept = count(first, "blur", "photos");
    assert!((30..=44).contains(&kept), "{kept} photos kept of two sols");
    let report = std::fs::read_to_string(dir.path().join("out/report.html")).unwrap();
    assert!(
        report.contains("bootstrap") && report.len() > 100_000,
        "{} bytes of report",
        report.len()
    );
    numbers_that_stand_twice_agree(&report);
    for file in [
        "train/weights.safetensors",
        "calibrate/transforms.json",
        "video/video.mp4",
        "uncertainty/video.mp4",
    ] {
        assert!(dir.path().join("out").join(file).exists(), "{file}");
    }

    let again = run(dir.path(), &[]);
    assert_eq!(again.nodes("finished"), Vec::<String>::new(), "nothing changed");

    let threshold = run(dir.path(), &["--set", "blur.min_share=0.51"]);
    assert_eq!(
        threshold.nodes("finished"),
        ["blur"],
        "same photos kept: nothing downstream runs"
    );
    assert_eq!(
        count(&threshold, "blur", "measured"),
        0,
        "a threshold decodes no photo"
    );

    let more = run(dir.path(), &["--set", "bootstrap.b=5"]);
    let mut ran = more.nodes("finished");
    ran.sort(); // members run side by side: either may end first
    let changed = [
        "bootstrap",
        "bootstrap/member-03",
        "bootstrap/member-04",
        "uncertainty",
        "uncertainty-frames",
    ];
    assert_eq!(ran, changed);

    let coarser = run(
        dir.path(),
        &["--set", "bootstrap.b=5", "--set", "video.quantizer=40"],
    );
    assert_eq!(
        coarser.nodes("finished"),
        ["video"],
        "another quality renders nothing"
    );

    let sol = run(dir.path(), &["--set", "archive.demo.sols=1..=3", "--to", "blur"]);
    assert_eq!(
        count(&sol, "extract", "fetched"),
        1,
        "only the new sol is fetched"
    );
    let new = count(&sol, "extract", "photos") - count(first, "extract", "photos");
    assert_eq!(
        count(&sol, "extract", "measured"),
        new,
        "only the new photos are measured"
    );

    let plan = marf(dir.path(), &["plan", "--json", "--set", "train.steps=13"]).exits(0);
    let rows: Vec<serde_json::Value> = serde_json::from_str(&plan.stdout).unwrap();
    let train = rows.iter().find(|row| row["node"] == "train").unwrap();
    assert_eq!(train["state"], "will_run");
}

#[test]
fn one_and_two_threads_give_the_same_digests() {
    let (one, (two, _)) = (demo(), ran());
    run(one.path(), &["--threads", "1"]);
    let (one, two) = (digests(one.path()), digests(two.path()));
    assert!(one.len() > 40, "{} outputs", one.len());
    assert_eq!(one, two);
}

/// A field of few steps has hardly a surface: what is exported is looked at where a ball is its own truth (marf-surface). Here is whether
/// the verbs run on the results of a run alone, and write what others read.
#[test]
fn exports_run_on_the_results_of_a_run() {
    let (dir, _) = ran();
    let said = marf(
        dir.path(),
        &[
            "export",
            "mesh",
            "--out",
            "e/mesh.glb",
            "--cell",
            "0.2",
            "--most-spread",
            "5",
        ],
    )
    .exits(0);
    assert!(
        said.stdout.contains("triangles") && said.stdout.contains("wrote e/mesh.glb"),
        "{}",
        said.stdout
    );
    let glb = std::fs::read(dir.path().join("e/mesh.glb")).unwrap();
    assert_eq!((&glb[..4], glb.len() % 4), (&b"glTF"[..], 0));
    // The same node of the store: only its copies are written.
    let ply = [
        "export",
        "mesh",
        "--out",
        "e/mesh.ply",
        "--cell",
        "0.2",
        "--most-spread",
        "5",
        "--json",
    ];
    let said = marf(dir.path(), &ply).exits(0);
    let told: serde_json::Value = serde_json::from_str(&said.stdout).unwrap();
    assert_eq!(told["files"], serde_json::json!(["e/mesh.ply"]));
    assert!(!said.stderr.contains("never ran"), "{}", said.stderr);
    let ply = std::fs::read(dir.path().join("e/mesh.ply")).unwrap();
    assert!(ply.starts_with(b"ply\n"));
    let made = marf(dir.path(), &["audit", "e/mesh.glb"]).exits(0);
    assert!(made.stdout.contains("surface-of-train"), "{}", made.stdout);

    let status = marf(dir.path(), &["status"]).exits(0);
    assert!(
        !status.stdout.contains("surface"),
        "an export is no run of the pipeline: {}",
        status.stdout
    );

    marf(dir.path(), &["export", "cameras", "--out", "cameras"]).exits(0);
    let text = std::fs::read_to_string(dir.path().join("cameras/transforms.json")).unwrap();
    let transforms: serde_json::Value = serde_json::from_str(&text).unwrap();
    for frame in transforms["frames"].as_array().unwrap() {
        let photo = dir
            .path()
            .join("cameras")
            .join(frame["file_path"].as_str().unwrap());
        let size = image::image_dimensions(&photo).unwrap();
        let width = frame.get("w").unwrap_or(&transforms["w"]).as_u64().unwrap();
        assert_eq!(u64::from(size.0), width, "{}", photo.display());
    }

    let refused = marf(dir.path(), &["export", "mesh", "--out", "mesh.obj"]).exits(2);
    assert!(refused.stderr.contains(".ply or .glb"), "{}", refused.stderr);
    let refused = marf(dir.path(), &["export", "points", "blur", "--out", "x.ply"]).exits(2);
    assert!(refused.stderr.contains("surface-of-blur"), "{}", refused.stderr);
    let refused = marf(dir.path(), &["export", "points", "nothing", "--out", "x.ply"]).exits(2);
    assert!(refused.stderr.contains("its nodes are"), "{}", refused.stderr);
}

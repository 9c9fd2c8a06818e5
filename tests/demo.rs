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

/// Returns the folded JSON of a part of a page, right after its summary. Its texts keep their other escapes.
fn folded(page: &str, summary: &str) -> serde_json::Value {
    let before = format!("<summary>{summary}</summary><pre>");
    let (_, after) = page.split_once(&before).expect(&before);
    let (escaped, _) = after.split_once("</pre>").unwrap();
    let json = escaped.replace("&quot;", "\"");
    serde_json::from_str(&json).unwrap_or_else(|error| panic!("{summary}: {error}: {json}"))
}

/// Compares the numbers of a report that stand at several places.
fn numbers_that_stand_twice_agree(page: &str) {
    let first = |before: &str| {
        let found = numbers(page, before);
        *found
            .first()
            .unwrap_or_else(|| panic!("no number after `{before}`"))
    };
    let section = |id: &str| page.split_once(&format!("<section id=\"{id}\">")).unwrap().1;
    let totals = folded(section("cameras"), "all metrics of the calibration")["totals"].take();
    let total = |key: &str| totals[key].as_f64().unwrap();
    // The first training of the page, as that of the figures.
    let trained = folded(section("training"), "all metrics");
    let figure = |name: &str| first(&format!("<dt>{name}</dt><dd>"));
    let rows = page.matches("<td class=\"who\">").count() as f64;
    assert_eq!(
        [first("<p class=\"quiet work\">Pipeline of "), first("Graph of ")],
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
    assert_eq!(numbers(section("kept"), "<p>")[0], kept, "photos kept");
    assert_eq!(total("photos"), kept, "photos that calibration was given");

    let [placed, held_out] = ["</h3><p>", "cameras, "].map(|before| numbers(section("cameras"), before)[0]);
    assert_eq!(
        [figure("photos placed"), total("registered")],
        [placed; 2],
        "placed"
    );
    let training = [
        figure("photos held out"),
        trained["held_out_photos"].as_f64().unwrap(),
        total("held_out"),
    ];
    assert_eq!(training, [held_out; 3], "held out");
    assert_eq!(
        figure("photos trained on") + held_out,
        placed,
        "trained on and held out"
    );
    for (name, key, decimals) in [("PSNR", "psnr", 2), ("SSIM", "ssim", 3)] {
        let [figure, value] = [figure(name), trained[key].as_f64().unwrap()];
        assert_eq!(
            format!("{figure:.decimals$}"),
            format!("{value:.decimals$}"),
            "{name}"
        );
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

/// Photos of one sol in a folder, all from which a field needs.
const FOLDER: &str = r#"name = "folder"
[archive.photos]
kind = "folder"
path = "photos"
[node.extract]
archive = "photos"
[node.calibrate]
input = "extract"
method = "sfm"
[node.train]
input = "calibrate"
steps = 400
scale = 2
device = "cpu"
field.batch_samples = 16384
"#;

/// Least gain on held-out photos. Corners that are a third too dark in one photo and not in the next cost more.
const LEAST_GAIN_DB: f64 = 0.5;

/// The photos of the demo's first two sols, as a folder with a pipeline.
fn photos() -> tempfile::TempDir {
    let (dir, demo) = (tempfile::tempdir().unwrap(), demo());
    let args = [
        "run",
        "--to",
        "calibrate",
        "--set",
        "archive.demo.width=340",
        "--set",
        "size.min_bytes=750",
    ];
    marf(demo.path(), &args).exits(0);
    marf(demo.path(), &["export", "cameras", "--out", "exported"]).exits(0);
    let photos = dir.path().join("photos");
    std::fs::create_dir_all(&photos).unwrap();
    for entry in std::fs::read_dir(demo.path().join("exported")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|ext| ext == "png") {
            std::fs::rename(&path, photos.join(path.file_name().unwrap())).unwrap();
        }
    }
    std::fs::write(dir.path().join("pipeline.toml"), FOLDER).unwrap();
    dir
}

/// Makes the corners of photos 30 % darker than their middle.
fn darken_corners(photos: &Path) {
    for entry in std::fs::read_dir(photos).unwrap() {
        let path = entry.unwrap().path();
        let mut photo = image::open(&path).unwrap().into_rgb8();
        let [width, height] = [photo.width(), photo.height()].map(f64::from);
        let corner = width.hypot(height) / 2.0;
        for (x, y, pixel) in photo.enumerate_pixels_mut() {
            let off = (f64::from(x) + 0.5 - width / 2.0).hypot(f64::from(y) + 0.5 - height / 2.0);
            let v = 1.0 - 0.3 * (off / corner).powi(2);
            pixel.0 = pixel.0.map(|tone| (f64::from(tone) * v + 0.5) as u8);
        }
        photo.save(&path).unwrap();
    }
}

/// What a training with a setting has measured, and its weights.
fn trained(folder: &Path, set: &[&str]) -> (serde_json::Value, Vec<u8>) {
    marf(folder, &[&["run"], set].concat()).exits(0);
    let file = |name: &str| std::fs::read(folder.join("out/train").join(name)).unwrap();
    let metrics = serde_json::from_slice(&file("metrics.json")).unwrap();
    (metrics, file("weights.safetensors"))
}

#[test]
fn dark_corners_are_found_and_taken_away_and_photos_without_keep_their_bytes() {
    const OFF: [&str; 2] = ["--set", "train.field.vignetting=off"];
    let dir = photos();
    let (plain, weights) = trained(dir.path(), &[]);
    assert_eq!(plain["config"].get("vignetting"), None, "{}", plain["vignetting"]);
    assert_eq!(trained(dir.path(), &OFF), (plain, weights));

    darken_corners(&dir.path().join("photos"));
    let (with, _) = trained(dir.path(), &[]);
    let report = std::fs::read_to_string(dir.path().join("out/report.html")).unwrap();
    let (without, _) = trained(dir.path(), &OFF);
    let found = &with["vignetting"];
    println!(
        "{} dB with it, {} without: {found}",
        with["psnr"], without["psnr"]
    );
    assert_eq!(with["config"]["vignetting"], "per_camera", "{found}");
    let darkening = |one: &serde_json::Value| one["darkening"].as_f64().unwrap();
    assert!(
        found
            .as_array()
            .unwrap()
            .iter()
            .all(|one| (darkening(one) - 0.3).abs() < 0.05),
        "{found}"
    );
    let psnr = |metrics: &serde_json::Value| metrics["psnr"].as_f64().unwrap();
    assert!(
        psnr(&with) > psnr(&without) + LEAST_GAIN_DB,
        "{} {}",
        with["psnr"],
        without["psnr"]
    );
    assert!(
        report.contains("<dt>vignetting</dt><dd>on: corners of"),
        "the reason is not in the report"
    );
}

//! Archives over the network, by the binary: increments, the lock, a kill in mid-download.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod common;

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use common::{Ran, marf};
use marf_loopback::{Reply, Server};

fn picture(sol: u32, number: u32) -> Vec<u8> {
    let noise = |x: u32, y: u32| (x * 7 + y * 13 + x * y * (sol + number)) as u8;
    let picture = image::RgbImage::from_fn(64, 48, |x, y| {
        image::Rgb([noise(x, y), noise(y, x), number as u8])
    });
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

fn mount(server: &Server, sols: impl IntoIterator<Item = u32>) {
    for sol in sols {
        for number in 0..4 {
            server.navcam(sol, number, picture(sol, number));
        }
    }
}

fn pipeline(server: &Server) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let archive = server.navcam_section("jezero", "1..=9");
    let text = format!(
        "name = \"archive\"\n{archive}[node.extract]\narchive = \"jezero\"\n[node.size]\ninput = \"extract\"\n\
         min_bytes = 100\n"
    );
    std::fs::write(dir.path().join("pipeline.toml"), text).unwrap();
    dir
}

fn run(folder: &Path, more: &[&str]) -> Ran {
    let mut args = vec!["run", "--json"];
    args.extend(more);
    marf(folder, &args)
}

/// A count of the extract node in the last event of a run.
fn count(ran: &Ran, what: &str) -> u64 {
    let events = ran.events();
    let finished = events
        .iter()
        .find(|json| json["event"] == "finished" && json["node"] == "extract");
    finished.expect("extract ran")["counts"][what].as_u64().unwrap()
}

#[test]
fn only_what_is_new_is_fetched_and_the_lock_replays_it_elsewhere() {
    let server = Server::start().unwrap();
    mount(&server, 1..=2);
    let dir = pipeline(&server);
    let plan = marf(dir.path(), &["plan"]).exits(0).stdout;
    assert!(plan.contains("never ran; 8 files to fetch"), "{plan}");
    assert!(
        !dir.path().join("marf.lock").exists(),
        "a plan fetches and pins nothing"
    );
    let first = run(dir.path(), &[]).exits(0);
    assert_eq!((count(&first, "photos"), count(&first, "fetched")), (8, 2));
    assert_eq!(run(dir.path(), &[]).exits(0).nodes("reused"), ["extract", "size"]);

    mount(&server, [3]);
    server.clear();
    let second = run(dir.path(), &[]).exits(0);
    assert_eq!((count(&second, "photos"), count(&second, "fetched")), (12, 1));
    let pictures = |server: &Server| {
        server
            .requests()
            .iter()
            .filter(|one| one.path().ends_with(".png"))
            .count()
    };
    assert_eq!(pictures(&server), 4);

    server.clear();
    assert_eq!(
        run(dir.path(), &["--offline"]).exits(0).nodes("reused"),
        ["extract", "size"]
    );
    assert!(server.requests().is_empty());

    let other = pipeline(&server);
    common::copy(&dir.path().join("marf.lock"), &other.path().join("marf.lock"));
    let refused = run(other.path(), &["--offline"]).exits(1);
    assert!(refused.stdout.contains("not in the store"), "{}", refused.stdout);
    let locked = run(other.path(), &["--locked"]).exits(0);
    assert_eq!(count(&locked, "photos"), 12);
    assert_eq!(
        digest(dir.path()),
        digest(other.path()),
        "the same photos, to the byte"
    );
}

fn digest(folder: &Path) -> String {
    let status = marf(folder, &["status", "--json"]).exits(0).stdout;
    let status: serde_json::Value = serde_json::from_str(&status).unwrap();
    let nodes = status["nodes"].as_array().unwrap();
    let extract = nodes.iter().find(|node| node["name"] == "extract").unwrap();
    extract["outputs"]["photos"]["digest"]
        .as_str()
        .unwrap()
        .to_owned()
}

#[test]
fn a_run_killed_in_mid_download_goes_on_from_there() {
    let server = Server::start().unwrap();
    mount(&server, [1]);
    // Half a download is vouched for at each MiB.
    let mut state = 1_u32;
    let noise = image::RgbImage::from_fn(1_024, 1_024, |_, _| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        image::Rgb([(state >> 8) as u8, (state >> 16) as u8, (state >> 24) as u8])
    });
    let mut bytes = std::io::Cursor::new(Vec::new());
    noise.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    let slow = server.navcam(1, 3, bytes.into_inner());
    let drip = Reply::Drip {
        bytes: 100_000,
        every: Duration::from_millis(50),
    };
    server.script(&slow, vec![drip]);
    let dir = pipeline(&server);
    let mut child = Command::new(env!("CARGO_BIN_EXE_marf"))
        .current_dir(dir.path())
        .arg("run")
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let downloads = dir.path().join(".marf/scratch/downloads");
    let begun = || {
        let parts = std::fs::read_dir(&downloads).into_iter().flatten().flatten();
        let sizes = parts.filter(|part| part.path().extension().is_some_and(|end| end == "part"));
        let sizes: Vec<u64> = sizes
            .map(|part| part.metadata().map_or(0, |meta| meta.len()))
            .collect();
        sizes.len() == 4 && sizes.iter().any(|size| *size > 1_500_000)
    };
    while !begun() {
        std::thread::sleep(Duration::from_millis(5));
        assert!(
            child.try_wait().unwrap().is_none(),
            "the run ended before it could be killed"
        );
    }
    child.kill().unwrap();
    child.wait().unwrap();
    server.clear();
    let ran = run(dir.path(), &[]).exits(0);
    assert_eq!(count(&ran, "photos"), 4);
    let pictures: Vec<_> = server
        .requests()
        .into_iter()
        .filter(|one| one.path().ends_with(".png"))
        .collect();
    assert_eq!(
        pictures.len(),
        1,
        "whole downloads are taken up without a request: {pictures:?}"
    );
    assert!(
        pictures[0].path() == slow && pictures[0].header("range").is_some(),
        "half a one goes on: {pictures:?}"
    );
    let left = std::fs::read_dir(&downloads).map_or(0, Iterator::count);
    assert_eq!(left, 0, "nothing is left of downloads that are in the store");
}

#[test]
fn an_archive_that_cannot_be_is_a_usage_error() {
    let server = Server::start().unwrap();
    let dir = pipeline(&server);
    for (set, part) in [
        (
            "archive.jezero.base=[\"http://example.com/x\"]",
            "http is taken for a loopback host alone",
        ),
        ("archive.jezero.base=[\"nonsense\"]", "not an address"),
        ("archive.jezero.instrument=helicam", "perseverance has no helicam"),
        ("archive.jezero.sols=5..=1", "empty range"),
        ("archive.jezero.network.connections=9", "not within 1 to 4"),
        (
            "archive.jezero.nonsense=1",
            "unknown key `nonsense` in `archive.jezero`",
        ),
    ] {
        let ran = run(dir.path(), &["--set", set]).exits(2);
        assert!(ran.stderr.contains(part), "{set}: {}", ran.stderr);
    }
    assert!(server.requests().is_empty());
}

/// Plays the raw-image feed of Mars 2020 from the saved records of a folder. Returns the number of records up to a
/// sol.
fn play(server: &Server, folder: &Path, last: u64) -> usize {
    let mut records = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let path = entry.path();
        if path.extension().is_none_or(|end| end != "json") {
            continue;
        }
        let mut record: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        let picture = ["png", "jpg"]
            .map(|end| path.with_extension(end))
            .into_iter()
            .find(|path| path.exists());
        let picture = picture.unwrap();
        let address = format!("/raw/{}", picture.file_name().unwrap().to_string_lossy());
        server.file(&address, std::fs::read(&picture).unwrap());
        record["image_files"]["full_res"] = server.url(&address).into();
        records.push(record);
    }
    let count = records
        .iter()
        .filter(|record| record["sol"].as_u64().unwrap() <= last)
        .count();
    server.feed("/rss/api/", move |_, query| {
        let sol = |record: &serde_json::Value| record["sol"].as_u64().unwrap();
        if query.contains("latest=true") {
            return Some(format!("{{\"latest_sol\": {}}}", records.iter().map(sol).max()?).into_bytes());
        }
        let bound = |key: &str| query.split(key).nth(1)?.split(':').next()?.parse::<u64>().ok();
        let (first, last) = (bound("condition_2=")?, bound("condition_3=")?);
        let found: Vec<_> = records
            .iter()
            .filter(|record| (first..=last).contains(&sol(record)))
            .collect();
        let images = if query.contains("page=0") {
            found.clone()
        } else {
            Vec::new()
        };
        Some(
            serde_json::json!({"images": images, "total_results": found.len()})
                .to_string()
                .into_bytes(),
        )
    });
    count
}

#[test]
fn the_real_feed_replayed_to_sol_400_and_then_whole_fetches_and_measures_only_the_new() {
    let Some(folder) = common::shared("m2020_navcam_feed") else {
        return;
    };
    let server = Server::start().unwrap();
    let early = play(&server, &folder, 400);
    let dir = tempfile::tempdir().unwrap();
    let text = format!(
        "[archive.raws]\nkind = \"feed\"\nmission = \"perseverance\"\ninstrument = \"navcam\"\nsols = \"50..=400\"\n\
         base = [\"{}\"]\nnetwork = {{ delay_ms = 0 }}\n[node.extract]\narchive = \"raws\"\n[node.size]\ninput = \"extract\"\n\
         [node.blur]\ninput = \"size\"\n",
        server.origin()
    );
    std::fs::write(dir.path().join("pipeline.toml"), text).unwrap();
    let measured = |ran: &Ran| {
        let events = ran.events();
        let finished = events
            .iter()
            .find(|json| json["event"] == "finished" && json["node"] == "extract");
        finished.unwrap()["counts"]["measured"].as_u64().unwrap()
    };
    let pictures = || {
        server
            .requests()
            .iter()
            .filter(|one| one.path().starts_with("/raw/"))
            .count()
    };
    let first = run(dir.path(), &[]).exits(0);
    assert_eq!(
        (count(&first, "photos"), pictures(), measured(&first)),
        (early as u64, early, early as u64)
    );
    server.clear();
    let all = run(dir.path(), &["--set", "archive.raws.sols=50..=900"]).exits(0);
    let new = 36 - early;
    assert_eq!(
        (count(&all, "photos"), pictures(), measured(&all)),
        (36, new, new as u64)
    );
}

/// A pipeline that reads a feed of one record, whose picture and camera are as marf expects.
fn feed(server: &Server, record: serde_json::Value) -> tempfile::TempDir {
    server.file("/raw/a.png", picture(5, 1));
    server.feed("/rss/api/", move |_, query| {
        let latest = query
            .contains("latest=true")
            .then(|| serde_json::json!({"latest_sol": 5}));
        let page = || serde_json::json!({"images": [record], "total_results": 1});
        Some(latest.unwrap_or_else(page).to_string().into_bytes())
    });
    let dir = tempfile::tempdir().unwrap();
    let text = format!(
        "[archive.raws]\nkind = \"feed\"\nmission = \"perseverance\"\ninstrument = \"navcam\"\nsols = \"latest\"\n\
         base = [\"{}\"]\nnetwork = {{ delay_ms = 0, retry_ms = 1, stall_s = 1 }}\n[archive.local]\nkind = \"demo\"\n\
         [node.extract]\narchive = \"raws\"\n",
        server.origin()
    );
    std::fs::write(dir.path().join("pipeline.toml"), text).unwrap();
    dir
}

fn record(server: &Server) -> serde_json::Value {
    serde_json::json!({
        "imageid": "NLF_0005", "sol": 5, "site": 3, "drive": "1950", "sample_type": "Full", "attitude": "(1,0,0,0)",
        "image_files": {"full_res": server.url("/raw/a.png")},
        "camera": {"instrument": "NAVCAM_LEFT", "camera_model_component_list":
            "(0.8,0.56,-1.92);(1,0,0);(32,60,0);(24,0,60)"},
        "extended": {"xyz": "(12.5,-3.25,0.125)", "dimension": "(64,48)"},
    })
}

#[test]
fn archives_are_checked_with_a_line_for_each_thing_and_an_exit_code() {
    let server = Server::start().unwrap();
    let dir = feed(&server, record(&server));
    let check = |args: &[&str]| marf(dir.path(), &[&["archive", "check"], args].concat());
    let well = check(&[]).exits(0);
    let expected = [
        "raws  as expected  latest sol              sol 5",
        "raws  as expected  records of sols 0 to 5  1 of 1 records",
        "raws  as expected  label                   `NLF_0005.json`: sol 5, instrument NAVCAM_LEFT, camera",
        "raws  as expected  picture                 `NLF_0005.png`: 64 x 48 pixels, ",
        "everything is as marf expects",
    ];
    for (line, start) in well.stdout.lines().zip(expected) {
        assert!(line.starts_with(start), "{line}");
    }
    assert_eq!(well.stdout.lines().count(), expected.len(), "{}", well.stdout);
    assert_eq!(server.requests().len(), 3, "the record of the feed is the label");
    assert!(!dir.path().join("marf.lock").exists() && !dir.path().join(".marf").exists());

    let document = |ran: &Ran| -> serde_json::Value { serde_json::from_str(&ran.stdout).unwrap() };
    let json = document(&check(&["raws", "--json"]).exits(0));
    assert_eq!(
        (&json["answer"], &json["archives"][0]["name"]),
        (&"as_expected".into(), &"raws".into())
    );
    assert_eq!(json["archives"][0]["checks"].as_array().unwrap().len(), 4);

    server.script("/raw/a.png", vec![Reply::status(404).always()]);
    let gone = check(&[]).exits(6);
    assert!(gone.stdout.contains("differs      picture"), "{}", gone.stdout);
    assert!(
        gone.stdout
            .contains(&format!("answers status 404 ({})", server.url("/raw/a.png"))),
        "{}",
        gone.stdout
    );
    assert!(
        gone.stderr.contains("error: 1 of 4 checks differ"),
        "{}",
        gone.stderr
    );
    assert_eq!(document(&check(&["--json"]).exits(6))["answer"], "differs");

    server.script("/rss/api/", vec![Reply::Silent.always()]);
    let silent = check(&[]).exits(1);
    assert!(
        silent.stdout.contains("not checked  latest sol"),
        "{}",
        silent.stdout
    );
    assert!(
        silent.stderr.contains("3 of 3 things could not be checked"),
        "{}",
        silent.stderr
    );

    for (args, part) in [
        (["rows"].as_slice(), "did you mean `raws`?"),
        (&["local"], "`local` is on this machine"),
        (
            &["--set", "archive.raws.kind=demo", "--set", "archive.raws.sols=1"],
            "unknown key",
        ),
    ] {
        let refused = check(args).exits(2);
        assert!(refused.stderr.contains(part), "{}", refused.stderr);
    }
    let other = tempfile::tempdir().unwrap();
    marf(other.path(), &["init"]).exits(0);
    let none = marf(other.path(), &["archive", "check"]).exits(2);
    assert!(
        none.stderr.contains("no archive of pipeline.toml is on a server"),
        "{}",
        none.stderr
    );
}

#[cfg(unix)]
#[test]
fn a_check_stops_when_it_is_asked_to() {
    let server = Server::start().unwrap();
    let dir = feed(&server, record(&server));
    server.script("/rss/api/", vec![Reply::Silent.always()]);
    let mut child = Command::new(env!("CARGO_BIN_EXE_marf"))
        .current_dir(dir.path())
        .args(["archive", "check", "--set", "archive.raws.network.stall_s=600"])
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    while server.requests().is_empty() {
        std::thread::sleep(Duration::from_millis(5));
        assert!(
            child.try_wait().unwrap().is_none(),
            "it ended before it was stopped"
        );
    }
    let kill = format!("kill -INT {}", child.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
}

//! Ctrl-C while a program waits for another one, or reads what has no end.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod common;

use std::fs::File;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use common::{SMALL_DEMO, copy, marf, photos, shared};

/// A program that was asked to stop must have ended after this time. It takes 2 s at most on a machine that does nothing else.
const LIMIT: Duration = Duration::from_secs(10);

const PIPELINE: &str = "name = \"waits\"\n[archive.photos]\nkind = \"folder\"\npath = \"photos\"\n[node.extract]\n\
                        archive = \"photos\"\n[node.size]\ninput = \"extract\"\n";

/// Waits until a thread of a program sleeps again and again, as it does between two attempts to take a lock.
fn await_wait(program: &mut Child, lock: &str) {
    let sleeps = |program: &Child| {
        let threads = std::fs::read_dir(format!("/proc/{}/task", program.id()));
        let mut threads = threads.into_iter().flatten().flatten();
        threads.any(|thread| {
            let place = std::fs::read_to_string(thread.path().join("wchan"));
            place.is_ok_and(|place| place.contains("nanosleep"))
        })
    };
    let mut in_a_row = 0;
    while in_a_row < 5 {
        in_a_row = if sleeps(program) { in_a_row + 1 } else { 0 };
        let ended = program.try_wait().unwrap();
        assert!(ended.is_none(), "it did not wait for {lock}: {ended:?}");
    }
}

fn start(folder: &Path, words: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_marf"))
        .current_dir(folder)
        .args(words)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Asks a program to stop. Returns its exit code and what it printed to stderr.
fn stop(program: Child, name: &str) -> (i32, String) {
    let asked = Instant::now();
    // It may have ended by itself.
    let kill = format!("kill -INT {} 2> /dev/null; true", program.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    let output = program.wait_with_output().unwrap();
    let (took, text) = (
        asked.elapsed(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    );
    assert!(took <= LIMIT, "{name}: {took:?}");
    let code = output.status.code();
    (
        code.unwrap_or_else(|| panic!("{name}: {:?}: {text}", output.status)),
        text,
    )
}

/// Waits until a program hears Ctrl-C, or has ended.
fn await_handler(program: &mut Child) {
    const SIGINT: u64 = 1 << 1;
    let hears = |id: u32| {
        let status = std::fs::read_to_string(format!("/proc/{id}/status")).unwrap_or_default();
        let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:\t"));
        caught.is_some_and(|caught| u64::from_str_radix(caught, 16).unwrap() & SIGINT != 0)
    };
    while program.try_wait().unwrap().is_none() && !hears(program.id()) {
        std::thread::yield_now();
    }
}

/// Makes a pipe that nobody writes to in place of a file.
fn pipe(path: &Path) {
    let _ = std::fs::remove_file(path);
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

/// A photo of 24 megapixels, and one whose scan comes 20,000 times.
fn large_photos(folder: &Path) {
    std::fs::create_dir(folder).unwrap();
    let picture = image::GrayImage::from_fn(6_000, 4_000, |x, y| image::Luma([(x / 60 + y / 60) as u8]));
    picture.save(folder.join("large.jpg")).unwrap();
    image::GrayImage::new(600, 400)
        .save(folder.join("scans.jpg"))
        .unwrap();
    let whole = std::fs::read(folder.join("scans.jpg")).unwrap();
    let scan = whole.windows(2).position(|bytes| bytes == [0xff, 0xda]).unwrap();
    let again = whole[scan..whole.len() - 2].repeat(20_000);
    std::fs::write(
        folder.join("scans.jpg"),
        [&whole[..scan], &again, &[0xff, 0xd9]].concat(),
    )
    .unwrap();
}

#[test]
fn ctrl_c_ends_every_verb_on_input_that_is_large_or_has_no_end() {
    let dir = photos();
    let folder = dir.path().canonicalize().unwrap();
    std::fs::write(folder.join("pipeline.toml"), PIPELINE).unwrap();
    marf(&folder, &["run"]).exits(0);
    marf(&folder, &["export", "crate", "crate"]).exits(0);
    let remote = format!("file://{}/shared", folder.display());
    marf(&folder, &["cache", "push", "--remote", &remote]).exits(0);

    copy(&folder.join("crate"), &folder.join("zero"));
    pipe(&folder.join("crate/bag-info.txt"));
    let member = folder.join("zero/data/pipeline.toml");
    std::fs::remove_file(&member).unwrap();
    std::os::unix::fs::symlink("/dev/zero", member).unwrap();
    for first in std::fs::read_dir(folder.join("shared/records")).unwrap() {
        for record in std::fs::read_dir(first.unwrap().path()).unwrap() {
            pipe(&record.unwrap().path());
        }
    }
    large_photos(&folder.join("large"));
    pipe(&folder.join("pipe"));
    let mut cases: Vec<Vec<&str>> = vec![
        vec!["verify", "crate"],
        vec!["verify", "zero"],
        vec!["audit", "photos/transforms.json", "--crate", "zero"],
        vec!["audit", "pipe"],
        vec!["audit", "/dev/zero"],
        vec!["render", "--path", "pipe", "--out", "frames"],
        vec!["plan", "--file", "pipe"],
        vec!["cache", "pull", "--store", "empty", "--remote", &remote],
        vec!["cache", "fsck", "--read-data", "--remote", &remote],
        vec!["photos", "large"],
        vec!["filter", "large"],
    ];
    let nested = shared("fault-inputs/xml_ns/photos");
    let nested = nested.map(|folder| folder.display().to_string());
    cases.extend(
        nested
            .as_deref()
            .map(|folder| vec!["photos", folder, "--store", "nested"]),
    );
    for words in cases {
        let mut program = start(&folder, &words);
        await_handler(&mut program);
        let (code, text) = stop(program, &format!("{words:?}"));
        assert!(
            code == 130 || code == 0 || text.contains("error: "),
            "{words:?}: {code}: {text}"
        );
    }
}

#[test]
fn ctrl_c_ends_every_wait_for_another_program() {
    let dir = photos();
    let folder = dir.path().canonicalize().unwrap();
    std::fs::write(folder.join("pipeline.toml"), PIPELINE).unwrap();
    marf(&folder, &["run"]).exits(0);
    let work = ["run", "--set", "size.min_bytes=7"];
    for (lock, words) in [
        ("locks/index", &work[..]),
        ("locks/index", &["status"]),
        ("locks/collect", &work),
        ("locks/runs", &work),
        ("locks/gc", &["cache", "gc"]),
        (
            "locks/collect",
            &["cache", "gc", "--grace", "0s", "--keep-last", "1"],
        ),
        ("tmp/.gate", &work),
    ] {
        let path = folder.join(".marf").join(lock);
        let held = File::options().create(true).append(true).open(&path).unwrap();
        held.lock().unwrap();
        let mut program = start(&folder, words);
        await_wait(&mut program, lock);
        let (code, text) = stop(program, &format!("{words:?} on {lock}"));
        assert_eq!(code, 130, "{words:?} on {lock}: {text}");
        assert!(
            text.ends_with("run the same command again to continue\n"),
            "{words:?} on {lock}: {text}"
        );
    }
    marf(&folder, &work).exits(0);
    marf(&folder, &["cache", "fsck", "--read-data"]).exits(0);
}

/// Stops the small demo as soon as its draft is done, and reads the report.
#[test]
fn after_ctrl_c_the_report_shows_the_draft_and_says_which_run_it_is_and_how_far() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().canonicalize().unwrap();
    marf(&folder, &["init"]).exits(0);
    let mut program = Command::new(env!("CARGO_BIN_EXE_marf"))
        .current_dir(&folder)
        .args(["run", "--json"])
        .args(SMALL_DEMO.iter().flat_map(|set| ["--set", set]))
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(program.stdout.take().unwrap()).lines();
    let is_end_of_draft = |line: &str| {
        let event: serde_json::Value = serde_json::from_str(line).unwrap();
        event["event"] == "finished" && event["node"] == "draft"
    };
    assert!(lines.any(|line| is_end_of_draft(&line.unwrap())), "no draft");
    let rest = std::thread::spawn(move || lines.count());
    let (code, text) = stop(program, "run");
    rest.join().unwrap();
    assert_eq!(code, 130, "{text}");
    let page = std::fs::read_to_string(folder.join("out/report.html")).unwrap();
    let stopped = page.split("<strong>Run 1 was stopped: ").nth(1);
    let stopped = stopped.unwrap_or_else(|| panic!("no state in {page}"));
    // The archive, six filters, the cameras and the draft.
    let done: usize = stopped.split(' ').next().unwrap().parse().unwrap();
    assert!(done >= 9, "{done} nodes done");
    for said in [
        "Results are kept. Run the same command again to continue.",
        "This is a draft, as `train` has no result yet.",
        "error of new views, draft",
    ] {
        assert!(page.contains(said), "{said}");
    }
    assert!(!page.contains("The run goes on"), "two states");
}

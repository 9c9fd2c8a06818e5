//! Ctrl-C while a program waits for another one.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod common;

use std::fs::File;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use common::marf;

/// A program that was asked to stop must have ended after this time.
const LIMIT: Duration = Duration::from_secs(2);

const PIPELINE: &str = "name = \"waits\"\n[archive.demo]\nkind = \"demo\"\nsols = \"1\"\n[node.extract]\narchive = \"demo\"\n\
                        [node.size]\ninput = \"extract\"\n";

/// Waits until a program has opened a file.
fn await_open(program: &mut Child, file: &Path) {
    let open = |program: &Child| {
        let files = std::fs::read_dir(format!("/proc/{}/fd", program.id()));
        let mut links = files.into_iter().flatten().flatten();
        links.any(|link| std::fs::read_link(link.path()).is_ok_and(|target| target == file))
    };
    while !open(program) {
        let ended = program.try_wait().unwrap();
        assert!(
            ended.is_none(),
            "it did not wait for {}: {ended:?}",
            file.display()
        );
    }
}

#[test]
fn ctrl_c_ends_every_wait_for_another_program() {
    let dir = tempfile::tempdir().unwrap();
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
        let mut program = Command::new(env!("CARGO_BIN_EXE_marf"))
            .current_dir(&folder)
            .args(words)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        await_open(&mut program, &path);
        let asked = Instant::now();
        let kill = format!("kill -INT {}", program.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
        let output = program.wait_with_output().unwrap();
        let (took, text) = (asked.elapsed(), String::from_utf8_lossy(&output.stderr));
        assert!(took <= LIMIT, "{words:?} on {lock}: {took:?}");
        assert_eq!(output.status.code(), Some(130), "{words:?} on {lock}: {text}");
        assert!(
            text.ends_with("run again to go on\n"),
            "{words:?} on {lock}: {text}"
        );
    }
    marf(&folder, &work).exits(0);
    marf(&folder, &["cache", "fsck", "--read-data"]).exits(0);
}

//! Ctrl-C while a program waits for another one.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod common;

use std::fs::File;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use common::{marf, photos};

/// A program that was asked to stop must have ended after this time.
const LIMIT: Duration = Duration::from_secs(2);

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
        let mut program = Command::new(env!("CARGO_BIN_EXE_marf"))
            .current_dir(&folder)
            .args(words)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        await_wait(&mut program, lock);
        let asked = Instant::now();
        let kill = format!("kill -INT {}", program.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
        let output = program.wait_with_output().unwrap();
        let (took, text) = (asked.elapsed(), String::from_utf8_lossy(&output.stderr));
        assert!(took <= LIMIT, "{words:?} on {lock}: {took:?}");
        assert_eq!(output.status.code(), Some(130), "{words:?} on {lock}: {text}");
        assert!(
            text.ends_with("run the same command again to continue\n"),
            "{words:?} on {lock}: {text}"
        );
    }
    marf(&folder, &work).exits(0);
    marf(&folder, &["cache", "fsck", "--read-data"]).exits(0);
}

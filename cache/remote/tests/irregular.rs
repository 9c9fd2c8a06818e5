//! A folder as a shared store that contains pipes, links and devices.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod common;

use std::time::Duration;

use common::{Quiet, World, run_in};
use marf_cache::{Digest, ReadShare};
use marf_remote::FsckOptions;

/// A pipe has no end and no writer, and a link may lead to anything.
#[test]
fn what_is_no_regular_file_is_damaged_and_no_call_waits_for_it() {
    for kind in ["pipe", "link", "device"] {
        for (folder, ending) in [
            ("records", ""),
            ("packs", ".idx"),
            ("packs", ".pack"),
            ("cas", ""),
            ("runs", ""),
        ] {
            let world = World::new();
            let (here, there) = (world.store("here"), world.store("there"));
            let run = run_in(&here);
            world.remote().push(&here, &run, &Quiet::default()).unwrap();
            for file in world.files(folder, ending) {
                let copy = world.dir.path().join("copy");
                std::fs::rename(&file, &copy).unwrap();
                match kind {
                    "pipe" => assert!(
                        std::process::Command::new("mkfifo")
                            .arg(&file)
                            .status()
                            .unwrap()
                            .success()
                    ),
                    "link" => std::os::unix::fs::symlink(&copy, &file).unwrap(),
                    _ => std::os::unix::fs::symlink("/dev/zero", &file).unwrap(),
                }
            }
            let began = std::time::Instant::now();
            let quiet = Quiet::default();
            let all = FsckOptions {
                read_data: ReadShare::ALL,
                repair: false,
            };
            let remote = world.remote();
            let root = Digest::from_content(run.root.as_bytes());
            let found = match remote.run(&root, &quiet) {
                Ok(found) => remote.pull(&there, &found, &quiet).map(drop),
                Err(error) => Err(error),
            };
            let error = found.unwrap_err().to_string();
            let why = match (kind, ending) {
                // A listing has files alone, so an object that is not a file and is found by a listing is
                // missing.
                ("pipe" | "device", ".idx") => "lacks blob",
                ("pipe" | "device", _) if folder == "runs" => "lacks the run",
                ("pipe", _) => "it is not a regular file",
                _ => "it is a link",
            };
            assert!(error.contains(why), "{kind} {folder} {ending}: {error}");
            let _ = world
                .remote()
                .fetch(&there, &run.keys, Duration::from_secs(10), &quiet);
            let report = world.remote().fsck(all, &quiet).unwrap();
            assert!(
                folder == "runs" || !report.faults.is_empty(),
                "{kind} {folder} {ending}"
            );
            assert!(
                began.elapsed() < Duration::from_secs(10),
                "{kind} {folder}: {:?}",
                began.elapsed()
            );
        }
    }
}

#[test]
fn a_form_that_is_a_pipe_is_damaged() {
    let world = World::new();
    std::fs::create_dir_all(world.folder()).unwrap();
    let format = world.folder().join("format");
    assert!(
        std::process::Command::new("mkfifo")
            .arg(format)
            .status()
            .unwrap()
            .success()
    );
    let error = world
        .remote()
        .runs(None, &Quiet::default())
        .unwrap_err()
        .to_string();
    assert!(error.ends_with("is damaged: it is not a regular file"), "{error}");
}

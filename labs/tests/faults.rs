//! The programme of faults, few rounds of each. `marf-labs faults` does many.
#![cfg(target_os = "linux")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop, and one that is skipped says so"
)]

mod common;

use std::path::Path;
use std::process::Command;

use common::{Ran, labs};

fn faults(folder: &Path, faults: &str, rounds: &str) -> Ran {
    let words = ["faults", "--rounds", rounds, "--fault", faults, "--dir", "lab"];
    labs(folder, &words)
}

/// Checks that every fault was done that often, and left nothing behind.
fn assert_done(folder: &Path, ran: &Ran, names: &[&str], rounds: u64) {
    let reports = ran.events();
    let found: Vec<&str> = reports
        .iter()
        .map(|report| report["fault"].as_str().unwrap())
        .collect();
    assert_eq!(found, names, "{}", ran.stdout);
    assert!(
        reports.iter().all(|report| report["rounds"] == rounds),
        "{}",
        ran.stdout
    );
    assert!(!folder.join("lab").exists());
}

#[test]
fn stops_damage_limits_and_false_clocks_change_no_digest() {
    let dir = tempfile::tempdir().unwrap();
    let names = ["kill", "interrupt", "damage", "limit", "clock"];
    let ran = faults(dir.path(), &names.join(","), "2").exits(0);
    assert_done(dir.path(), &ran, &names, 2);
}

#[test]
fn stopped_fetches_change_no_digest_and_pin_only_what_is_whole() {
    let dir = tempfile::tempdir().unwrap();
    let names = ["fetch-kill", "fetch-interrupt"];
    let ran = faults(dir.path(), &names.join(","), "3").exits(0);
    assert_done(dir.path(), &ran, &names, 3);
}

#[test]
fn eight_programs_and_collections_beside_them_change_no_digest() {
    let dir = tempfile::tempdir().unwrap();
    let names = ["eight", "collect"];
    let ran = faults(dir.path(), &names.join(","), "1").exits(0);
    assert_done(dir.path(), &ran, &names, 1);
}

#[test]
fn full_disks_and_read_only_stores_end_in_one_error_and_change_no_digest() {
    let dir = tempfile::tempdir().unwrap();
    let names = ["full", "read-only"];
    let ran = faults(dir.path(), &names.join(","), "2");
    if ran.code == 1 && ran.stderr.contains("cannot be mounted for this fault") {
        println!("skipped: needs a user who may mount in a namespace");
        return;
    }
    assert_done(dir.path(), &ran.exits(0), &names, 2);
}

#[test]
fn a_fault_that_cannot_be_done_here_is_an_error_with_the_way_out() {
    let dir = tempfile::tempdir().unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_marf-labs"))
        .current_dir(dir.path())
        .args(["faults", "--fault", "full", "--rounds", "1"])
        .env("PATH", "/nowhere")
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{words}");
    assert!(
        words.contains("max_user_namespaces") && words.contains("--fault"),
        "{words}"
    );
    assert!(output.stdout.is_empty(), "no report of a fault that was not done");
}

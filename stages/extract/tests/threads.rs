//! A listing uses the threads it was given.
#![cfg(target_os = "linux")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop; helpers of tests are not seen as tests"
)]

mod common;

use marf_stage::harness::Harness;

fn threads() -> usize {
    std::fs::read_dir("/proc/self/task").unwrap().count()
}

/// The only test of its program, so that no other starts threads meanwhile.
#[test]
fn a_folder_that_is_listed_with_one_thread_starts_no_other() {
    let dir = tempfile::tempdir().unwrap();
    for number in 0..100 {
        std::fs::write(dir.path().join(format!("{number}.png")), "x").unwrap();
    }
    let stage = common::stage(common::folder(dir.path())).unwrap();
    let harness = Harness::default();
    let before = threads();
    common::source(stage.as_ref()).list(&harness.ctx()).unwrap();
    assert_eq!(threads(), before);
}

use super::common::marf;
use super::{SMALL, after_a_run, assert_transcript, with_pipeline};

#[test]
fn log_before_the_first_run() {
    assert_transcript!(with_pipeline(SMALL).path(), &[&["log"]]);
}

#[test]
fn log_of_three_runs() {
    let dir = after_a_run();
    marf(dir.path(), &["run", "--set", "shape.min_width=121"]).exits(0);
    marf(dir.path(), &["run", "--to", "size"]).exits(0);
    assert_transcript!(dir.path(), &[&["log"], &["log", "-n", "1"]]);
}

use super::common::marf;
use super::{SMALL, after_a_run, assert_transcript, with_pipeline};

#[test]
fn status_before_the_first_run() {
    assert_transcript!(with_pipeline(SMALL).path(), &[&["status"]]);
}

#[test]
fn status_after_a_run() {
    let dir = after_a_run();
    assert_transcript!(dir.path(), &[&["status"]]);
}

#[test]
fn status_after_a_failure() {
    let text = "[archive.photos]\nkind = \"folder\"\npath = \"nowhere\"\n[node.extract]\narchive = \"photos\"\n\
                [node.size]\ninput = \"extract\"\n";
    let dir = with_pipeline(text);
    marf(dir.path(), &["run"]).exits(1);
    assert_transcript!(dir.path(), &[&["status"]]);
}

use super::{SMALL, after_a_run, assert_transcript, with_pipeline};

#[test]
fn why_before_the_first_run() {
    assert_transcript!(with_pipeline(SMALL).path(), &[&["why", "size"]]);
}

#[test]
fn why_after_a_run() {
    assert_transcript!(
        after_a_run().path(),
        &[
            &["why", "size"],
            &["why", "size", "--set", "size.min_bytes=2001"],
            &["why", "shape", "--set", "size.min_bytes=2001"],
            &["why", "extract", "--set", "archive.demo.sols=1..=2"],
            &["why", "blur"],
        ]
    );
}

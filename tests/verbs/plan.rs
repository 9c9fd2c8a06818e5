use super::{SMALL, after_a_run, assert_transcript, with_pipeline};

#[test]
fn plan_before_the_first_run() {
    assert_transcript!(
        with_pipeline(SMALL).path(),
        &[&["plan"], &["plan", "--to", "size"]]
    );
}

#[test]
fn plan_after_a_run() {
    assert_transcript!(
        after_a_run().path(),
        &[
            &["plan"],
            &["plan", "--set", "shape.min_width=121"],
            &["plan", "--set", "size.min_bytes=2001"],
            &["plan", "--set", "archive.demo.sols=1..=2"],
            &["plan", "--json", "--from", "shape"],
        ]
    );
}

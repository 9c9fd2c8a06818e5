use super::common::{marf, photos};
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

/// A folder is listed file by file, so its differences are reported before anything is read.
#[test]
fn why_files_of_a_changed_folder() {
    let dir = photos();
    let pipeline = "name = \"folder\"\n[archive.photos]\nkind = \"folder\"\npath = \"photos\"\n\
                    [node.extract]\narchive = \"photos\"\n[node.blur]\ninput = \"extract\"\n";
    std::fs::write(dir.path().join("pipeline.toml"), pipeline).unwrap();
    marf(dir.path(), &["run"]).exits(0);
    let images = dir.path().join("photos/images");
    std::fs::remove_file(images.join("0.png")).unwrap();
    std::fs::copy(images.join("1.png"), images.join("4.png")).unwrap();
    image::RgbImage::new(32, 24).save(images.join("2.png")).unwrap();
    let why: &[&str] = &["why", "blur", "--files"];
    assert_transcript!(dir.path(), &[&["why", "extract", "--files"], why]);
}

//! A run of some two thousand photos.

use std::sync::LazyLock;
use std::time::Instant;

use super::common::marf;
use super::devtools::Page;
use super::{Viewer, http};

/// Most bytes of a page, however many photos there are.
const MOST_BYTES: usize = 1_000_000;

const MANY: &str = "name = \"many\"\n[archive.demo]\nkind = \"demo\"\nsols = \"1..=60\"\nwidth = 24\n\
    [node.extract]\narchive = \"demo\"\n[node.size]\ninput = \"extract\"\nmin_bytes = 100\n\
    [node.calibrate]\ninput = \"size\"\nmethod = \"labels\"\nhold_every = 100\n\
    [node.train]\ninput = \"calibrate\"\nsteps = 2\nphotos = 100\n";

fn many_run() -> &'static std::path::Path {
    static RUN: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("pipeline.toml"), MANY).unwrap();
        marf(dir.path(), &["run"]).exits(0);
        dir
    });
    RUN.path()
}

#[test]
fn a_page_of_two_thousand_photos_is_small_and_scrolls() {
    let viewer = Viewer::start(many_run(), &[]);
    let began = Instant::now();
    let whole = http::request(&viewer.authority, "GET", "/", &[], b"").is(200);
    println!("{} bytes after {:?}", whole.body.len(), began.elapsed());
    assert!(whole.body.len() <= MOST_BYTES, "{} bytes", whole.body.len());
    let text = whole.text();
    assert!(text.contains("2,040 photos"), "{text}");
    let Some(mut page) = Page::open(&viewer.address) else {
        return;
    };
    page.waits_for("document.getElementById('view-stage').dataset.divisor === '1'");
    page.opens_all_sections();
    // From top to bottom, a window at a time: every picture that comes into sight is there, and the page goes on answering.
    let longest_ms = page.value(
        "(async () => { let longest = 0, last = performance.now(); \
         for (let top = 0; top < document.body.scrollHeight; top += innerHeight) { \
           scrollTo(0, top); await new Promise(requestAnimationFrame); \
           longest = Math.max(longest, performance.now() - last); last = performance.now(); } return longest; })()",
    );
    println!("longest time between two pictures of the page while it scrolls: {longest_ms} ms");
    page.waits_for("[...document.images].every((picture) => picture.loading !== 'lazy' || !picture.src || picture.complete)");
    assert!(page.value("scrollY").as_f64().unwrap() > 1000.0);
    page.keeps("many.png");
    assert!(page.complaints().is_empty(), "{:?}", page.complaints());
}

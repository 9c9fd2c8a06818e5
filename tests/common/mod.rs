//! Runs the binary as a user would.
#![allow(
    dead_code,
    clippy::print_stdout,
    unused_imports,
    reason = "each test file uses a part; a skipped test says so"
)]

mod photos;
mod ran;
pub mod tools;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

pub use photos::photos;
pub use ran::Ran;

/// The default pipeline at a sixteenth of its pixels and a handful of steps.
pub const SMALL_DEMO: [&str; 17] = [
    "archive.demo.width=160",
    "size.min_bytes=750",
    "shape.min_width=80",
    "shape.min_height=60",
    "draft.scale=4",
    "draft.judged_scale=4",
    "draft.steps=6",
    "tune.scale=4",
    "train.scale=4",
    "tune.trials=2",
    "tune.steps=3",
    "train.steps=12",
    "bootstrap.b=3",
    "uncertainty-frames.frames=2",
    "uncertainty-frames.width=80",
    "render.frames=2",
    "render.width=80",
];

/// One sol of the built-in Mars, small, and a field that has a surface. With fewer steps it is fog, which takes longer to render.
pub const SURFACE: &str = r#"name = "surface"
[archive.demo]
kind = "demo"
sols = "1"
width = 160

[node.extract]
archive = "demo"

[node.calibrate]
input = "extract"
method = "labels"

[node.train]
input = "calibrate"
steps = 200
scale = 1
field.batch_samples = 16384
"#;

/// Runs `marf ARGS` in a folder, without a terminal and at a line width of 100.
pub fn marf(folder: &Path, args: &[&str]) -> Ran {
    Ran::new(env!("CARGO_BIN_EXE_marf"), folder, args)
}

/// Returns a folder in which a pipeline has run, unchanged since: a copy of one run that all tests of a file
/// share.
///
/// `name` distinguishes the pipelines of all files.
pub fn ran(name: &str, pipeline: &str) -> tempfile::TempDir {
    static DONE: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    let whole = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("ran-{name}"));
    let mut done = DONE.lock().unwrap_or_else(PoisonError::into_inner);
    if !done.contains(name) {
        // What an earlier `cargo test` left is of another program.
        let _ = std::fs::remove_dir_all(&whole);
        std::fs::create_dir_all(&whole).unwrap();
        std::fs::write(whole.join("pipeline.toml"), pipeline).unwrap();
        marf(&whole, &["run"]).exits(0);
        done.insert(name.to_owned());
    }
    drop(done);
    let dir = tempfile::tempdir().unwrap();
    copy(&whole, dir.path());
    dir
}

/// Copies a folder with all that is in it.
pub fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        match path.is_dir() {
            true => copy(&path, &target),
            false => match std::fs::copy(&path, &target) {
                // A program that uses the folder has removed a temporary file since it was listed.
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => (),
                copied => drop(copied.unwrap()),
            },
        }
    }
}

/// Real photos, if they exist: `$MARF_SHARED_DATA`, or `../shared/data` next to the checkout.
pub fn shared(set: &str) -> Option<PathBuf> {
    let beside = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data"));
    let root = std::env::var_os("MARF_SHARED_DATA").map_or_else(beside, PathBuf::from);
    let folder = root.join(set);
    if folder.exists() {
        return Some(folder);
    }
    println!("skipped: needs ../shared/data/{set}");
    None
}

//! Runs the binary as a user would.
#![allow(
    dead_code,
    clippy::print_stdout,
    reason = "each test file uses a part; a skipped test says so"
)]

pub mod tools;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};

/// The default pipeline at a quarter of its pixels and a handful of steps.
pub const SMALL_DEMO: [&str; 14] = [
    "archive.demo.width=320",
    "size.min_bytes=3000",
    "shape.min_width=160",
    "shape.min_height=120",
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

/// One sol of the built-in Mars, small, and a field of few steps that has a surface.
pub const SURFACE: &str = r#"name = "surface"
[archive.demo]
kind = "demo"
sols = "1"
width = 320

[node.extract]
archive = "demo"

[node.calibrate]
input = "extract"
method = "labels"

[node.train]
input = "calibrate"
steps = 200
scale = 2
"#;

/// What a run of the binary left.
pub struct Ran {
    /// Exit code; -1 if killed.
    pub code: i32,
    /// What it printed to stdout.
    pub stdout: String,
    /// What it printed to stderr.
    pub stderr: String,
}

/// Runs `marf ARGS` in a folder, without a terminal and at a line width of 100.
pub fn marf(folder: &Path, args: &[&str]) -> Ran {
    let output = Command::new(env!("CARGO_BIN_EXE_marf"))
        .current_dir(folder)
        .args(args)
        .stdin(Stdio::null())
        .env("COLUMNS", "100")
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Ran {
        code: output.status.code().unwrap_or(-1),
        stdout: text(&output.stdout),
        stderr: text(&output.stderr),
    }
}

impl Ran {
    /// Panics with everything that was printed unless the code is as expected.
    #[track_caller]
    pub fn exits(self, code: i32) -> Self {
        assert_eq!(
            self.code, code,
            "\nstdout: {}\nstderr: {}",
            self.stdout, self.stderr
        );
        self
    }

    /// The JSON lines of `--json`.
    pub fn events(&self) -> Vec<serde_json::Value> {
        self.stdout
            .lines()
            .map(|line| serde_json::from_str(line).unwrap_or_else(|_| panic!("{line}")))
            .collect()
    }

    /// Names of the nodes that ran, by the lines of progress on stderr.
    pub fn done(&self) -> Vec<&str> {
        let done = self.stderr.lines().filter_map(|line| line.strip_prefix("done "));
        done.map(|line| line.split_whitespace().next().unwrap()).collect()
    }

    /// Names of the nodes with this event, in order.
    pub fn nodes(&self, event: &str) -> Vec<String> {
        let events = self.events().into_iter().filter(|json| json["event"] == event);
        events
            .map(|json| json["node"].as_str().unwrap_or_default().to_owned())
            .collect()
    }
}

/// Returns a folder in which a pipeline has run, as it was left: a copy of one run that all tests of a file share.
///
/// `name` tells the pipelines of all files apart.
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
            false => drop(std::fs::copy(&path, &target).unwrap()),
        }
    }
}

/// Real photos, where they are: `$MARF_SHARED_DATA`, or `../shared/data` beside the checkout.
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

/// Four photos in a row; the last is a test photo.
pub fn photos() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos/images");
    std::fs::create_dir_all(&folder).unwrap();
    for number in 0..4_u32 {
        let picture = image::RgbImage::from_fn(32, 24, |x, y| {
            image::Rgb([x * 7 + number, y * 10, x * y % 256].map(|value| value as u8))
        });
        picture.save(folder.join(format!("{number}.png"))).unwrap();
    }
    let name = |number: u32| format!("images/{number}.png");
    let frame = |number: u32| {
        let matrix = [[1, 0, 0, number], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]];
        serde_json::json!({"file_path": name(number), "transform_matrix": matrix})
    };
    let transforms = serde_json::json!({
        "w": 32, "h": 24, "fl_x": 30.5, "fl_y": 31.0, "cx": 16.0, "cy": 12.0,
        "frames": [frame(0), frame(1), frame(2), frame(3)],
        "train_filenames": [name(0), name(1), name(2)], "test_filenames": [name(3)],
    });
    let path = dir.path().join("photos/transforms.json");
    std::fs::write(path, transforms.to_string()).unwrap();
    dir
}

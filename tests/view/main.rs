//! `marf view` over small real runs: by plain requests, and in a real browser where there is one.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop; a skipped test and a figure are said"
)]

mod browser;
#[path = "../common/mod.rs"]
mod common;
mod devtools;
mod distances;
mod films;
mod hostile;
mod http;
mod keyboard;
mod live;
mod many;
mod pages;
mod report;
mod splats;

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;

use common::{SMALL_DEMO, marf};

/// A folder in which the small demo has run, with two retrainings, for as many steps as a surface needs.
fn small_run() -> &'static Path {
    static RUN: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
        let dir = tempfile::tempdir().unwrap();
        marf(dir.path(), &["init"]).exits(0);
        let mut args = vec!["run", "--to", "bootstrap"];
        for set in SMALL_DEMO.iter().chain(&["bootstrap.b=2", "train.steps=160"]) {
            args.extend(["--set", set]);
        }
        marf(dir.path(), &args).exits(0);
        // Once, so that not every page makes them.
        let splats = dir.path().join("splats.ply");
        marf(
            dir.path(),
            &["export", "splats", "--out", &splats.to_string_lossy()],
        )
        .exits(0);
        dir
    });
    RUN.path()
}

/// Returns a folder with a run on a photo whose name is a script, without a field.
fn hostile_run() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("photos")).unwrap();
    for (index, name) in ["<img src=x onerror=document.title='hit'>.png", "b.png"]
        .iter()
        .enumerate()
    {
        let picture = image::RgbImage::from_fn(64, 48, |x, y| {
            image::Rgb([x, y, (x * y + index as u32) % 251].map(|value| value as u8))
        });
        picture.save(dir.path().join("photos").join(name)).unwrap();
    }
    let pipeline = "name = \"<script>document.title='hit'</script>\"\n[archive.mine]\nkind = \"folder\"\npath = \"photos\"\n\
        [node.extract]\narchive = \"mine\"\n[node.size]\ninput = \"extract\"\nmin_bytes = 10\n";
    std::fs::write(dir.path().join("pipeline.toml"), pipeline).unwrap();
    marf(dir.path(), &["run"]).exits(0);
    dir
}

/// A running `marf view`, which is stopped at the end.
struct Viewer {
    child: Child,
    /// `127.0.0.1:PORT`.
    authority: String,
    /// What was printed.
    address: String,
}

impl Viewer {
    /// Starts `marf view` on a free port.
    fn start(folder: &Path, args: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_marf"))
            .current_dir(folder)
            .args(["view", "--port", "0"])
            .args(args)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut address = String::new();
        BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut address)
            .unwrap();
        let address = address.trim().to_owned();
        let rest = address
            .strip_prefix("http://")
            .unwrap_or_else(|| panic!("{address}"));
        let authority = rest.split('/').next().unwrap().to_owned();
        Self {
            child,
            authority,
            address,
        }
    }

    /// Reads a path without further headers.
    fn get(&self, path: &str) -> http::Answer {
        http::request(&self.authority, "GET", path, &[], b"")
    }

    /// Sends JSON as the page does.
    fn post(&self, path: &str, body: &serde_json::Value) -> http::Answer {
        let origin = format!("http://{}", self.authority);
        http::request(
            &self.authority,
            "POST",
            path,
            &[("Origin", &origin)],
            body.to_string().as_bytes(),
        )
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

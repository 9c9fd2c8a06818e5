//! Which run a verb answers for, whatever verbs were called before it.
//!
//! A pipeline has run once as a whole. Any sequence of verbs follows: runs of it and of parts of it, runs that fail, verbs on another
//! folder, exports, renders. Then `status`, `view` and `report` show the newest run of the pipeline, and `export`, `replay` and `audit`
//! still give what the whole run gave.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod common;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;

use common::marf;
use proptest::prelude::*;
use proptest::test_runner::{Config, TestCaseError, TestRunner};

/// One sol of the built-in Mars, small, and a field with two retrainings.
const PIPELINE: &str = r#"name = "whole"
[archive.demo]
kind = "demo"
sols = "1"
width = 80

[node.extract]
archive = "demo"

[node.calibrate]
input = "extract"
method = "labels"

[node.train]
input = "calibrate"
steps = 250
scale = 1
field.batch_samples = 8192

[node.bootstrap]
input = "calibrate"
training = "train"
b = 2
"#;

const MESH: &str =
    "export mesh --color uncertainty --cell 0.05 --most-spread 5 --least-photos 1 --out mesh.ply";

/// A verb that is called, and what it does to the answers of others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    Whole,
    Part,
    Rest,
    Failing,
    Filter,
    Calibrate,
    Photos,
    Mesh,
    Crate,
    Render,
}

impl Step {
    const ALL: [Self; 10] = [
        Self::Whole,
        Self::Part,
        Self::Rest,
        Self::Failing,
        Self::Filter,
        Self::Calibrate,
        Self::Photos,
        Self::Mesh,
        Self::Crate,
        Self::Render,
    ];

    fn line(self) -> &'static str {
        match self {
            Self::Whole => "run",
            Self::Part => "run --to calibrate",
            Self::Rest => "run --from bootstrap",
            Self::Failing => "run --set calibrate.method=import",
            Self::Filter => "filter photos --out verdicts.csv",
            Self::Calibrate => "calibrate photos --method import --out cameras/transforms.json",
            Self::Photos => "photos photos",
            Self::Mesh => MESH,
            Self::Crate => "export crate step-crate",
            Self::Render => "render --frames 2 --width 80 --out rendered",
        }
    }

    fn code(self) -> i32 {
        i32::from(self == Self::Failing)
    }

    /// Whether it is a run of the pipeline.
    fn is_run(self) -> bool {
        matches!(self, Self::Whole | Self::Part | Self::Rest | Self::Failing)
    }

    /// Whether it leaves a result of every node.
    fn is_whole(self) -> bool {
        matches!(self, Self::Whole | Self::Rest)
    }
}

/// The files of the runs of a store, by number.
fn runs(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder.join(".marf/runs")).unwrap();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

/// A folder in which verbs are called, and the runs that others are to answer for.
struct Desk {
    dir: tempfile::TempDir,
    mesh: Vec<u8>,
    /// The file of the newest run of the pipeline, in any state.
    newest: PathBuf,
    /// The file of the newest run that has every result.
    whole: PathBuf,
    /// The file of the run that wrote the report: one that does nothing keeps it.
    reported: PathBuf,
}

impl Desk {
    /// A copy of a folder in which the pipeline has run once, with the mesh that it gives.
    fn new() -> Self {
        static WHOLE: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
            let dir = common::photos();
            std::fs::write(dir.path().join("pipeline.toml"), PIPELINE).unwrap();
            call(dir.path(), "run", 0);
            call(dir.path(), MESH, 0);
            dir
        });
        let dir = tempfile::tempdir().unwrap();
        common::copy(WHOLE.path(), dir.path());
        let first = runs(dir.path()).remove(0);
        let mesh = std::fs::read(dir.path().join("mesh.ply")).unwrap();
        assert!(mesh.len() > 10_000, "an empty mesh is the same of any run");
        Self {
            mesh,
            dir,
            newest: first.clone(),
            reported: first.clone(),
            whole: first,
        }
    }

    fn step(&mut self, step: Step) {
        let before = runs(self.dir.path());
        let _ = std::fs::remove_dir_all(self.dir.path().join("step-crate"));
        call(self.dir.path(), step.line(), step.code());
        let made: Vec<PathBuf> = runs(self.dir.path())
            .into_iter()
            .filter(|run| !before.contains(run))
            .collect();
        if step.is_run() {
            let last = std::mem::replace(&mut self.newest, made.last().unwrap().clone());
            if !self.does_nothing(&last) {
                self.reported.clone_from(&self.newest);
            }
        }
        if step.is_whole() {
            self.whole.clone_from(made.last().unwrap());
        }
    }

    fn record(&self, run: &Path) -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(run).unwrap()).unwrap()
    }

    /// Whether the newest run has reused all that the run before it had, and nothing else.
    fn does_nothing(&self, before: &Path) -> bool {
        let keys = |run: &serde_json::Value| -> Vec<(String, String)> {
            let nodes = run["nodes"].as_array().unwrap().iter();
            nodes
                .map(|node| (node["name"].to_string(), node["key"].to_string()))
                .collect()
        };
        let newest = self.record(&self.newest);
        let mut nodes = newest["nodes"].as_array().unwrap().iter();
        nodes.all(|node| node["state"] == "reused") && keys(&newest) == keys(&self.record(before))
    }

    /// Compares the answers of all verbs with the runs that they are to answer for.
    fn check(&self) -> Result<(), TestCaseError> {
        let folder = self.dir.path();
        let newest = self.record(&self.newest);
        let status: serde_json::Value = serde_json::from_str(&call(folder, "status --json", 0)).unwrap();
        prop_assert_eq!(&status["id"], &newest["id"], "status");
        prop_assert_eq!(shown_by_view(folder), number(&self.newest), "view");
        call(folder, "report --out report.html", 0);
        let report = std::fs::read_to_string(folder.join("report.html")).unwrap();
        let reported = self.record(&self.reported);
        let command = reported["command"].as_str().unwrap();
        prop_assert!(
            report.contains(&format!("<code>{command}</code>")),
            "report: no {}",
            command
        );

        call(folder, MESH, 0);
        let mesh = std::fs::read(folder.join("mesh.ply")).unwrap();
        prop_assert!(mesh == self.mesh, "export mesh --color uncertainty: another mesh");
        let _ = std::fs::remove_dir_all(folder.join("crate"));
        call(folder, "export crate crate", 0);
        let root = std::fs::read(folder.join("crate/data/run.json")).unwrap();
        prop_assert!(
            root == std::fs::read(&self.whole).unwrap(),
            "export crate: another run"
        );
        let replay: serde_json::Value = serde_json::from_str(&call(folder, "replay --json", 0)).unwrap();
        prop_assert_eq!(replay["run"].as_u64().unwrap(), number(&self.whole), "replay");
        let audit: serde_json::Value =
            serde_json::from_str(&call(folder, "audit out/train/weights.safetensors --json", 0)).unwrap();
        prop_assert_eq!(&audit["answer"], "whole", "audit");
        Ok(())
    }
}

/// Calls a verb, which ends with a code. Returns its stdout.
#[track_caller]
fn call(folder: &Path, line: &str, code: i32) -> String {
    let args: Vec<&str> = line.split(' ').collect();
    marf(folder, &args).exits(code).stdout
}

/// The number in the name of a run's file.
fn number(run: &Path) -> u64 {
    let name = run.file_name().unwrap().to_string_lossy();
    name.split('-').next().unwrap().parse().unwrap()
}

/// The number of the run that `marf view` shows.
fn shown_by_view(folder: &Path) -> u64 {
    let mut viewer = Command::new(env!("CARGO_BIN_EXE_marf"))
        .current_dir(folder)
        .args(["view", "--port", "0"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut address = String::new();
    BufReader::new(viewer.stdout.take().unwrap())
        .read_line(&mut address)
        .unwrap();
    let authority = address.trim().trim_start_matches("http://").trim_end_matches('/');
    let mut stream = TcpStream::connect(authority).unwrap();
    write!(stream, "GET / HTTP/1.0\r\nHost: {authority}\r\n\r\n").unwrap();
    let mut page = String::new();
    stream.read_to_string(&mut page).unwrap();
    viewer.kill().unwrap();
    viewer.wait().unwrap();
    let (_, rest) = page.split_once("data-run=\"").unwrap_or_else(|| panic!("{page}"));
    rest.split('"').next().unwrap().parse().unwrap()
}

/// Calls the verbs in turn, then compares.
fn answers_hold_after(steps: &[Step]) -> Result<(), TestCaseError> {
    let mut desk = Desk::new();
    for step in steps {
        desk.step(*step);
    }
    desk.check()
}

#[test]
fn verbs_on_another_folder_and_exports_hide_nothing_of_a_run() {
    for steps in [
        &[Step::Mesh, Step::Filter, Step::Photos][..],
        &[Step::Render, Step::Failing, Step::Calibrate, Step::Part],
    ] {
        answers_hold_after(steps).unwrap_or_else(|error| panic!("{steps:?}: {error}"));
    }
}

#[test]
fn any_sequence_of_verbs_leaves_the_answers_of_all_verbs_right() {
    let config = Config {
        cases: 2,
        max_shrink_iters: 0,
        failure_persistence: None,
        ..Config::default()
    };
    let steps = prop::collection::vec(prop::sample::select(Step::ALL.to_vec()), 2..=6);
    TestRunner::new(config)
        .run(&steps, |steps| answers_hold_after(&steps))
        .unwrap();
}

//! A program that a test has run to its end. The laboratory's tests use it, too.

use std::path::Path;
use std::process::{Command, Stdio};

/// What a run of a program left.
pub struct Ran {
    /// Exit code, or -1 if killed.
    pub code: i32,
    /// What it printed to stdout.
    pub stdout: String,
    /// What it printed to stderr.
    pub stderr: String,
}

impl Ran {
    /// Runs a program in a folder, without a terminal and at a line width of 100.
    pub fn new(program: &str, folder: &Path, args: &[&str]) -> Self {
        let output = Command::new(program)
            .current_dir(folder)
            .args(args)
            .stdin(Stdio::null())
            .env("COLUMNS", "100")
            .output()
            .unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self {
            code: output.status.code().unwrap_or(-1),
            stdout: text(&output.stdout),
            stderr: text(&output.stderr),
        }
    }

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

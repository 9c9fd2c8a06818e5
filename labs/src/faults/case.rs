//! A folder with the pipeline, its store and its outputs, and runs in it.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;

use super::injector::{Outcome, RoundError};

/// The outputs of all nodes: name of node and output to digest.
pub type Outputs = BTreeMap<String, String>;

/// Which of two pipelines is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variant {
    /// As it is written.
    Plain,
    /// With another threshold early on: its run reads most of what a run before has stored.
    Changed,
}

/// A pipeline in a folder of its own.
#[derive(Debug, Clone)]
pub struct Case {
    /// The program marf.
    pub program: OsString,
    pub dir: PathBuf,
    /// What stands before its commands.
    pub wrapper: Vec<OsString>,
}

impl Case {
    /// Returns the folder of the store.
    pub fn store(&self) -> PathBuf {
        self.dir.join(".marf")
    }

    /// Returns marf with arguments, to be run in the folder.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut words = self.wrapper.iter().chain([&self.program]);
        let mut command = Command::new(words.next().unwrap_or(&self.program));
        command.args(words).arg("-C").arg(&self.dir).args(arguments);
        command
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        command
    }

    /// Returns the command of a run.
    pub fn run_command(&self, variant: Variant) -> Command {
        let mut command = self.command(&["run", "--device", "cpu"]);
        if variant == Variant::Changed {
            command.args(["--set", "size.min_bytes=1"]);
        }
        command
    }

    /// Starts a run.
    ///
    /// # Errors
    /// A program that cannot be started.
    pub fn start(&self, variant: Variant, threads: &[&str]) -> Outcome<Child> {
        let mut command = self.run_command(variant);
        Ok(command.args(threads).stderr(Stdio::null()).spawn()?)
    }

    /// Runs to the end.
    pub fn ends(&self, variant: Variant) -> Outcome {
        is_success("run", &self.run_command(variant).output()?)
    }

    /// Returns the digests of the last run.
    ///
    /// # Errors
    /// A store that cannot be read.
    pub fn outputs(&self) -> Outcome<Outputs> {
        let mut outputs = Outputs::new();
        for node in self.nodes()? {
            for (name, output) in node["outputs"].as_object().into_iter().flatten() {
                let node = node["name"].as_str().unwrap_or_default();
                let digest = output["digest"].as_str().unwrap_or_default();
                outputs.insert(format!("{node}:{name}"), digest.to_owned());
            }
        }
        Ok(outputs)
    }

    /// Checks that no node of the last run had anything to do.
    pub fn ran_nothing(&self) -> Outcome {
        let nodes = self.nodes()?;
        match nodes.iter().filter(|node| node["state"] != "reused").count() {
            0 => Ok(()),
            ran => Err(RoundError::Bad(format!("{ran} nodes ran again"))),
        }
    }

    /// Returns the nodes of the last run.
    fn nodes(&self) -> Outcome<Vec<Value>> {
        let mut command = self.command(&["status", "--json"]);
        let output = command.stdout(Stdio::piped()).output()?;
        is_success("status", &output)?;
        let bad = |what: &dyn std::fmt::Display| RoundError::Bad(format!("status: {what}"));
        let mut run: Value = serde_json::from_slice(&output.stdout).map_err(|error| bad(&error))?;
        match run["nodes"].take() {
            Value::Array(nodes) => Ok(nodes),
            other => Err(bad(&other)),
        }
    }
}

/// Returns the files below a folder, sorted, by relative path.
pub fn files_of(dir: &Path) -> Vec<PathBuf> {
    let entries = walkdir::WalkDir::new(dir).sort_by_file_name();
    let files = entries
        .into_iter()
        .flatten()
        .filter(|entry| entry.file_type().is_file());
    files
        .filter_map(|file| Some(file.path().strip_prefix(dir).ok()?.to_owned()))
        .collect()
}

/// Checks that a program ended well.
pub fn is_success(what: &str, output: &Output) -> Outcome {
    if output.status.success() {
        Ok(())
    } else {
        Err(bad_end(what, output))
    }
}

/// Checks that a run ended well, or in one error with these words and exit code 1. Returns whether it was the
/// error.
///
/// # Errors
/// Returns an error for any other end.
pub fn ends_in_one_error(output: &Output, words: &str) -> Outcome<bool> {
    let text = String::from_utf8_lossy(&output.stderr);
    let errors = text.lines().filter(|line| line.starts_with("error:"));
    match (output.status.code(), errors.count()) {
        (Some(0), 0) => Ok(false),
        (Some(1), 1) if text.contains(words) => Ok(true),
        _ => Err(bad_end("run", output)),
    }
}

fn bad_end(what: &str, output: &Output) -> RoundError {
    let text = String::from_utf8_lossy(&output.stderr);
    let lines: Vec<&str> = text.lines().collect();
    let last = lines[lines.len().saturating_sub(4)..].join(" | ");
    RoundError::Bad(format!("{what}: {}: {last}", output.status))
}

//! A folder with the pipeline, its store and its outputs, and runs in it.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;

use super::lab::{Lab, Outputs, Variant};
use super::{Outcome, RoundError};
use marf_run::Error;

/// A pipeline in a folder of its own.
pub struct Case<'a> {
    pub lab: &'a Lab,
    pub dir: PathBuf,
    /// What stands before its commands.
    pub wrapper: Vec<OsString>,
}

impl<'a> Case<'a> {
    /// Returns the case in a folder; makes nothing.
    pub fn at(lab: &'a Lab, dir: PathBuf) -> Self {
        Self {
            lab,
            dir,
            wrapper: Vec::new(),
        }
    }

    /// Returns the folder of the store.
    pub fn store(&self) -> PathBuf {
        self.dir.join(".marf")
    }

    /// Removes the folder, if it is there.
    ///
    /// # Errors
    /// A folder that cannot be removed.
    pub fn remove(&self) -> Result<(), Error> {
        if self.dir.exists() {
            super::remove(&self.dir)
        } else {
            Ok(())
        }
    }

    /// Returns this program with arguments, to be run in the folder.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let program = self.lab.program.clone().into_os_string();
        let mut words = self.wrapper.iter().cloned().chain([program]);
        let mut command = Command::new(words.next().unwrap_or_default());
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
        command.args(variant.arguments());
        command
    }

    /// Starts a run.
    ///
    /// # Errors
    /// A program that cannot be started.
    pub fn start(&self, variant: Variant, threads: &[&str]) -> Result<Child, RoundError> {
        let mut command = self.run_command(variant);
        Ok(command.args(threads).stderr(Stdio::null()).spawn()?)
    }

    /// Runs to the end.
    pub fn ends(&self, variant: Variant) -> Outcome {
        is_success("run", &self.run_command(variant).output()?)
    }

    /// Runs to the end and compares every digest.
    pub fn ends_equal(&self, variant: Variant) -> Outcome {
        self.ends(variant)?;
        self.lab.compare(variant, &self.outputs()?)
    }

    /// Verifies all of the store, and the pins beside it.
    pub fn is_whole(&self) -> Outcome {
        self.lab.compare_pins(&self.dir.join("marf.lock"))?;
        let is_visible = self.wrapper.is_empty();
        if is_visible && !self.store().is_dir() {
            return Ok(()); // the run ended before it had begun
        }
        let mut command = self.command(&["cache", "fsck", "--read-data"]);
        is_success("fsck", &command.output()?)
    }

    /// Returns the digests of the last run.
    ///
    /// # Errors
    /// A store that cannot be read.
    pub fn outputs(&self) -> Result<Outputs, RoundError> {
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
    fn nodes(&self) -> Result<Vec<Value>, RoundError> {
        let output = self
            .command(&["status", "--json"])
            .stdout(Stdio::piped())
            .output()?;
        is_success("status", &output)?;
        let bad = |what: &dyn std::fmt::Display| RoundError::Bad(format!("status: {what}"));
        let mut run: Value = serde_json::from_slice(&output.stdout).map_err(|error| bad(&error))?;
        match run["nodes"].take() {
            Value::Array(nodes) => Ok(nodes),
            other => Err(bad(&other)),
        }
    }

    /// Makes this folder one with the pipeline and the store of another case.
    ///
    /// # Errors
    /// Files that cannot be copied.
    pub fn copy_store(&self, from: &Case<'_>) -> Result<(), Error> {
        let (from, to) = (from.store(), self.store());
        let failed =
            |error: std::io::Error| Error::failed(format!("cannot copy {}: {error}", from.display()));
        for entry in walkdir::WalkDir::new(&from).into_iter().filter_map(Result::ok) {
            let Ok(below) = entry.path().strip_prefix(&from) else {
                continue;
            };
            let target = to.join(below);
            if entry.file_type().is_dir() {
                std::fs::create_dir_all(&target).map_err(failed)?;
            } else {
                std::fs::copy(entry.path(), &target).map_err(failed)?;
            }
        }
        Ok(())
    }
}

/// Returns the files below a folder, sorted, by relative path.
pub fn files_of(dir: &Path) -> Vec<PathBuf> {
    let entries = walkdir::WalkDir::new(dir).sort_by_file_name().into_iter();
    let files = entries
        .filter_map(Result::ok)
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

/// Checks that a run ended well, or in one error of these words with exit code 1; tells whether it was the error.
///
/// # Errors
/// Any other end.
pub fn ends_in_one_error(output: &Output, words: &str) -> Result<bool, RoundError> {
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

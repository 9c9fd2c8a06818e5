//! The selection of a run if the user names no run.
//!
//! A pipeline is its file and its name. Runs of a part of it (`--to`, `--from`, `--scene`) are runs of it. Everything made from a
//! run (exports, renders, trades, comparisons) is attached to that run and never represents the pipeline.

use marf_cache::Store;
use marf_engine::{Outcome, Purpose, RunRecord, RunSource, document, last_run_where, run_of};
use serde_json::Value;

use crate::error::RunError;

/// The subject of runs: a pipeline, a folder, or anything.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Subject {
    /// A pipeline: its file, and its name. `None` matches every name that the file has had.
    Pipeline {
        /// The file.
        source: RunSource,
        /// The name.
        name: Option<String>,
    },
    /// Verbs that build a pipeline for a folder.
    Folder,
    /// Anything.
    Any,
}

/// The run that a verb takes.
#[derive(Debug, Clone, PartialEq)]
pub struct Selected {
    /// The run.
    pub run: RunRecord,
    /// The newest run, if it is another one.
    pub newer: Option<RunRecord>,
}

impl Subject {
    /// Returns the subject of a folder without a pipeline file: its folder verbs, or anything if no folder verb has
    /// run.
    ///
    /// # Errors
    /// A store that cannot be read.
    pub fn without_file(store: &Store, warn: impl Fn(String)) -> Result<Self, RunError> {
        let folder = newest(store, &Self::Folder, warn)?;
        Ok(folder.map_or(Self::Any, |_| Self::Folder))
    }

    /// Returns whether a run is one of the subject.
    pub fn has(&self, run: &RunRecord) -> bool {
        self.covers(&run.source, &run.pipeline)
    }

    /// Returns whether a run with this source and name of the pipeline is one of the subject.
    pub fn covers(&self, from: &RunSource, pipeline: &str) -> bool {
        match self {
            Self::Pipeline { source, name } => {
                from == source && name.as_ref().is_none_or(|name| pipeline == name)
            }
            Self::Folder => matches!(from, RunSource::Folder { .. }),
            Self::Any => !from.is_derived(),
        }
    }
}

/// Returns the newest run of a subject in any state.
///
/// # Errors
/// Returns an error if the store cannot be read. A run that cannot be read is skipped with a warning.
pub fn newest(
    store: &Store,
    subject: &Subject,
    warn: impl Fn(String),
) -> Result<Option<RunRecord>, RunError> {
    newest_with(store, subject, warn, |_| true)
}

/// Returns the newest run of a subject for which `wanted` is true.
///
/// # Errors
/// As [`newest`].
pub fn newest_with(
    store: &Store,
    subject: &Subject,
    warn: impl Fn(String),
    wanted: impl Fn(&RunRecord) -> bool,
) -> Result<Option<RunRecord>, RunError> {
    Ok(last_run_where(store, warn, |run| {
        subject.has(run) && wanted(run)
    })?)
}

/// Returns the newest earlier run of the same pipeline for which `wanted` is true. `run` itself need not be stored yet.
///
/// # Errors
/// As [`newest`].
pub fn earlier(
    store: &Store,
    run: &RunRecord,
    warn: impl Fn(String),
    wanted: impl Fn(&RunRecord) -> bool,
) -> Result<Option<RunRecord>, RunError> {
    let is_earlier = |other: &RunRecord| run.number == 0 || other.number < run.number;
    Ok(last_run_where(store, warn, |other| {
        is_earlier(other) && other.pipeline == run.pipeline && other.source == run.source && wanted(other)
    })?)
}

/// Returns the newest run of a subject in which every node of its own pipeline has a result. Without such a run, returns the
/// newest that was done, or else the newest with any result.
///
/// # Errors
/// As [`newest`].
pub fn newest_whole(
    store: &Store,
    subject: &Subject,
    warn: impl Fn(String),
) -> Result<Option<Selected>, RunError> {
    let (mut last, mut done, mut some) = (None, None, None);
    for number in store.run_numbers()?.into_iter().rev() {
        let run = match run_of(store, number) {
            Ok(run) if subject.has(&run) => run,
            Ok(_) => continue,
            Err(error) => {
                warn(format!("{error}. The run is skipped"));
                continue;
            }
        };
        let newest = last.get_or_insert_with(|| run.clone());
        if is_whole(store, &run) {
            let newer = (newest.number != run.number).then(|| newest.clone());
            return Ok(Some(Selected { run, newer }));
        }
        if run.nodes.iter().any(|node| node.state.is_good()) {
            if done.is_none() && run.outcome == Outcome::Done {
                done = Some(run.clone());
            }
            some.get_or_insert(run);
        }
    }
    let selected = done.or(some).map(|run| Selected {
        newer: last.filter(|newest| newest.number != run.number),
        run,
    });
    Ok(selected)
}

/// Returns whether every node of the pipeline that a run was started with has a result. False if the store has lost the pipeline.
fn is_whole(store: &Store, run: &RunRecord) -> bool {
    let resolved = run.documents.get(document::RESOLVED);
    let bytes = resolved.and_then(|resolved| store.get(&resolved.digest).ok());
    let tree: Option<Value> = bytes.and_then(|bytes| serde_json::from_slice(&bytes).ok());
    let nodes = tree.as_ref().and_then(|tree| tree["node"].as_object());
    let is_good = |name: &String| run.node(name).is_some_and(|node| node.state.is_good());
    nodes.is_some_and(|nodes| !nodes.is_empty() && nodes.keys().all(is_good))
}

/// Returns the newest wanted run for a purpose that was made from a run of the same pipeline. Where the run that it was made from is gone, the
/// name of the pipeline decides.
///
/// # Errors
/// As [`newest`].
pub fn newest_derived(
    store: &Store,
    run: &RunRecord,
    purpose: Purpose,
    warn: impl Fn(String),
    wanted: impl Fn(&RunRecord) -> bool,
) -> Result<Option<RunRecord>, RunError> {
    let runs = marf_engine::runs(store, warn)?;
    let own = pipeline_source(&runs, run);
    let is_wanted = |other: &&RunRecord| {
        let is_for = matches!(other.source, RunSource::Derived { purpose: found, .. } if found == purpose);
        let source = pipeline_source(&runs, other);
        let is_other = source.is_some() && own.is_some() && source != own;
        is_for && other.pipeline == run.pipeline && !is_other && wanted(other)
    };
    Ok(runs.iter().rev().find(is_wanted).cloned())
}

/// Returns the source of the pipeline of a run. For a derived run, that of the run it was made from, if that exists.
fn pipeline_source<'r>(runs: &'r [RunRecord], run: &'r RunRecord) -> Option<&'r RunSource> {
    let mut run = run;
    // A run may be made from a run that was made from another one. A root is never that of a run that it leads to.
    while let RunSource::Derived { from, .. } = run.source {
        run = runs.iter().find(|base| from.is_some() && base.root == from)?;
    }
    Some(&run.source)
}

//! A run made again in an empty store, from its root and the pinned bytes alone.

use std::path::{Path, PathBuf};

use marf_cache::Store;
use marf_engine::{Options, Outcome};
use marf_model::Run;
use marf_provenance::replay::{Replayed, compare};
use serde::Serialize;

use super::plan::{Plan, plan};
use super::target::{Target, target};
use crate::context::{Context, open_store};
use crate::error::{Answer, Diagnostic, Error};
use crate::program;

/// The outcome of a replay.
#[derive(Debug, Serialize)]
pub struct ReplayReport {
    /// Number of the run.
    pub run: u64,
    /// The node that was repeated with all that leads to it. Absent for all nodes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub node: Option<String>,
    /// The answer in a word.
    pub answer: Answer,
    /// Threads that the replay used.
    pub threads: usize,
    /// The nodes.
    pub nodes: Vec<Replayed>,
}

/// Repeats a run and compares digests. `what` is the number of a run, a node of the last run, or a file that a run wrote, by default the
/// last run. `scratch` is the folder for the store of the replay, which is kept. By default it is temporary.
///
/// # Errors
/// A needed object that is lost, a folder that is not empty, a run that fails.
pub fn replay(context: &Context, what: Option<&str>, scratch: Option<&Path>) -> Result<ReplayReport, Error> {
    let store = context.existing_store()?;
    let Target { run, node } = target(context, &store, what)?;
    let lineage = Run::new(&store, run)?;
    let nodes = match &node {
        Some(node) => lineage.upstream(node),
        None => lineage.nodes.iter().collect(),
    };
    let temporary = scratch.is_none().then(tempfile::tempdir).transpose();
    let temporary = temporary.map_err(|error| Error::failed(error.to_string()))?;
    let dir = match (scratch, &temporary) {
        (Some(dir), _) => dir.to_owned(),
        (None, Some(temporary)) => temporary.path().join("store"),
        (None, None) => PathBuf::new(),
    };
    let scratch = empty_store(context, &dir)?;
    let Plan { graph, to, not_made } = plan(&lineage, &nodes, &scratch).map_err(incomplete)?;
    let options = Options {
        threads: context.threads,
        to,
        pipeline: lineage.record.pipeline.clone(),
        command: format!("replay of run {}", lineage.record.number),
        program: program::PROGRAM.to_owned(),
        ..Options::default()
    };
    let listener = context.feedback.follow("replay");
    let record = marf_engine::run(&graph, &scratch, &options, &*listener, &context.cancel)?;
    if record.outcome == Outcome::Cancelled {
        return Err(Error::Interrupted);
    }
    let replay = Run::new(&scratch, record)?;
    let replayed = compare(&lineage, &nodes, &replay, &not_made)?;
    scratch.take_warnings().into_iter().for_each(context.warnings());
    Ok(ReplayReport {
        run: lineage.record.number,
        answer: answer(&replayed),
        node,
        threads: replay.record.threads,
        nodes: replayed,
    })
}

/// Opens the store of a replay. It must be empty, because its contents would count as results of the replay.
fn empty_store(context: &Context, dir: &Path) -> Result<Store, Error> {
    let is_empty = std::fs::read_dir(dir).map_or(true, |mut entries| entries.next().is_none());
    if !is_empty {
        return Err(Error::usage(format!(
            "--scratch {}: the folder is not empty",
            dir.display()
        )));
    }
    open_store(dir, &context.cancel)
}

/// Makes an answer of an error that something is lost.
fn incomplete(error: Error) -> Error {
    match error {
        Error::Failed(diagnostic) => Error::Answered(Answer::Incomplete, diagnostic),
        other => other,
    }
}

/// Returns whether a node came out otherwise.
pub fn differs(node: &Replayed) -> bool {
    !node.differs.is_empty()
}

/// Returns whether a node could not be made again here.
pub fn is_missing(node: &Replayed) -> bool {
    node.not_made.is_some()
}

/// Returns the answer. A difference counts before a result that could not be computed, and that before results that are equal.
fn answer(nodes: &[Replayed]) -> Answer {
    if nodes.iter().any(differs) {
        Answer::Differs
    } else if nodes.iter().any(is_missing) {
        Answer::NotMade
    } else if nodes.iter().any(Replayed::is_equal) {
        Answer::Whole
    } else {
        Answer::NoResult
    }
}

/// Returns an error unless every result is equal.
///
/// # Errors
/// [`Error::Answered`]: differs, not made, or nothing to compare.
pub fn is_equal(report: &ReplayReport) -> Result<(), Error> {
    let run = report.run;
    let diagnostic = Diagnostic::new(match report.answer {
        Answer::Differs => format!("a result of run {run} is different"),
        Answer::NotMade => format!("a part of run {run} could not be repeated here"),
        Answer::NoResult => format!("run {run} has no result to compare with"),
        _ => return Ok(()),
    });
    let hint = (report.answer == Answer::NoResult)
        .then(|| "`marf log` lists all runs. Name one with results".to_owned());
    Err(Error::Answered(report.answer, Diagnostic { hint, ..diagnostic }))
}

#[cfg(test)]
mod tests {
    use marf_provenance::replay::DifferingOutput;

    use super::*;

    fn node(differs: &[&str], not_made: Option<&str>) -> Replayed {
        let output = |name: &&str| DifferingOutput {
            output: (*name).to_owned(),
            was: None,
            is: None,
            difference: None,
        };
        Replayed {
            node: "n".to_owned(),
            equal: 1,
            differs: differs.iter().map(output).collect(),
            not_made: not_made.map(str::to_owned),
        }
    }

    #[test]
    fn a_difference_counts_before_what_could_not_be_made_and_that_before_what_is_equal() {
        let made = || node(&[], None);
        let missing = || node(&[], Some("out of memory"));
        let differing = || node(&["field"], None);
        for (nodes, expected) in [
            (vec![], Some(Answer::NoResult)),
            (vec![made()], None),
            (vec![made(), missing()], Some(Answer::NotMade)),
            (vec![missing(), differing(), made()], Some(Answer::Differs)),
        ] {
            let report = ReplayReport {
                run: 1,
                node: None,
                answer: answer(&nodes),
                threads: 1,
                nodes,
            };
            let found = match is_equal(&report) {
                Err(Error::Answered(answer, _)) => Some(answer),
                _ => None,
            };
            assert_eq!(found, expected, "{report:?}");
        }
    }
}

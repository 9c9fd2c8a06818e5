//! `marf replay`: a run made again in an empty store, from its root and the pinned bytes alone.

mod plan;
mod target;

use std::path::PathBuf;

use clap::Args;
use marf_cache::Store;
use marf_engine::{Cancel, Options, Outcome};
use marf_provenance::difference::value_text;
use marf_provenance::lineage::Lineage;
use marf_provenance::replay::{NotMade, Replayed, compare};
use serde::Serialize;

pub use self::plan::resolved;
use self::plan::{Plan, plan};
use self::target::{Target, target};
use super::args::Global;
use super::error::{Answer, CliError, Diagnostic};
use super::output::print_json;
use super::program;
use super::session::{existing_store, warn};
use super::progress::Progress;
use crate::terminal::{escape_control, print_line};

/// Arguments of `replay`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct ReplayArgs {
    /// Number of a run, a node of the last run, or a file that a run made [default: the last run]
    #[arg(value_name = "RUN|NODE|FILE")]
    pub what: Option<String>,
    /// Folder for the store of the replay, which is kept [default: a temporary one]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
}

const AFTER_HELP: &str = "\
Nothing is asked of any server, and nothing of the first run is used but its root, the files that it read from archives, and \
the results of stages that are declared to vary (COLMAP's cameras). A training by the clock is repeated by the schedule that \
it ran.
Exit codes of the answer: 0 every digest is equal, 3 the file was not made by marf, 5 something that is needed is not in the \
store any more, 7 something came out otherwise, 9 nothing did, but not everything could be made again here (it ran on another \
GPU, or failed).";

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Report<'a> {
    run: u64,
    threads: usize,
    nodes: &'a [Replayed],
}

/// `marf replay`: runs a run, a node or what made a file again, and compares digests.
pub fn replay(global: &Global, args: &ReplayArgs, cancel: &Cancel) -> Result<(), CliError> {
    let store = existing_store(global, cancel)?;
    let Target { run, node } = target(&store, args.what.as_deref())?;
    let lineage = Lineage::of(&store, run)?;
    let nodes = match &node {
        Some(node) => lineage.upstream(node),
        None => lineage.nodes.iter().collect(),
    };
    let temporary = match args.scratch {
        Some(_) => None,
        None => Some(tempfile::tempdir().map_err(|error| CliError::failed(error.to_string()))?),
    };
    let dir = match (&args.scratch, &temporary) {
        (Some(dir), _) => dir.clone(),
        (None, Some(temporary)) => temporary.path().join("store"),
        (None, None) => PathBuf::new(),
    };
    let scratch = empty_store(&dir, cancel)?;
    let Plan { graph, to, not_made } = plan(&lineage, &nodes, &scratch).map_err(incomplete)?;
    let options = Options {
        threads: global.threads,
        to,
        pipeline: lineage.run.pipeline.clone(),
        command: format!("replay of run {}", lineage.run.number),
        program: program::PROGRAM.to_owned(),
        ..Options::default()
    };
    let record = marf_engine::run(&graph, &scratch, &options, &Progress::for_stderr(), cancel)?;
    if record.outcome == Outcome::Cancelled {
        return Err(CliError::Interrupted);
    }
    let replayed = compare(&lineage, &nodes, (&record, &scratch), &not_made)?;
    let report = Report {
        run: lineage.run.number,
        threads: record.threads,
        nodes: &replayed,
    };
    match global.json {
        true => print_json(&report)?,
        false => print_line(&escape_control(&text(&report))),
    }
    scratch.take_warnings().into_iter().for_each(warn);
    told(&report)
}

/// Opens the store of a replay, which must be empty: what it had would be taken for what the replay made.
fn empty_store(dir: &std::path::Path, cancel: &Cancel) -> Result<Store, CliError> {
    let is_empty = std::fs::read_dir(dir).map_or(true, |mut entries| entries.next().is_none());
    if !is_empty {
        return Err(CliError::usage(format!(
            "--scratch {}: the folder is not empty",
            dir.display()
        )));
    }
    super::session::open_store(dir, cancel)
}

/// Makes an answer of an error that something is lost.
fn incomplete(error: CliError) -> CliError {
    match error {
        CliError::Failed(diagnostic) => CliError::Answered(Answer::Incomplete, diagnostic),
        other => other,
    }
}

fn text(report: &Report<'_>) -> String {
    let mut lines = Vec::new();
    for node in report.nodes {
        let word = match (&node.not_made, node.differs.len()) {
            (Some(NotMade::TakenOver(why)), _) => format!("taken over: {why}"),
            (Some(NotMade::NotMade(why)), _) => format!("not made: {why}"),
            (None, 0) => format!("equal, {} outputs", node.equal),
            (None, count) => format!("differs, {count} of {} outputs", node.equal + count as u64),
        };
        lines.push(format!("{:<22} {word}", node.node));
        lines.extend(
            node.differs
                .iter()
                .map(|output| format!("  {}", difference(output))),
        );
    }
    let count = |wanted: fn(&Replayed) -> bool| report.nodes.iter().filter(|node| wanted(node)).count();
    let outputs: u64 = report.nodes.iter().map(|node| node.equal).sum();
    lines.push(format!(
        "run {} on {} threads: {outputs} outputs of {} nodes are equal, {} nodes differ, {} are declared to vary, {} were not made",
        report.run,
        report.threads,
        count(Replayed::is_equal),
        count(differs),
        count(|node| matches!(node.not_made, Some(NotMade::TakenOver(_)))),
        count(is_missing),
    ));
    if let Some(first) = report.nodes.iter().find(|node| differs(node)) {
        lines.push(format!("the first that differs is `{}`", first.node));
    }
    lines.join("\n")
}

fn differs(node: &Replayed) -> bool {
    !node.differs.is_empty()
}

fn is_missing(node: &Replayed) -> bool {
    matches!(node.not_made, Some(NotMade::NotMade(_)))
}

/// Most values of a document that are named.
const MOST_VALUES: usize = 3;

fn difference(output: &marf_provenance::replay::DifferingOutput) -> String {
    let digest =
        |digest: Option<marf_cache::Digest>| digest.map_or("absent".to_owned(), |digest| digest.short());
    let mut text = format!(
        "{}: {} -> {}",
        output.output,
        digest(output.was),
        digest(output.is)
    );
    if let Some(found) = &output.difference {
        let (was, is) = found.bytes;
        text.push_str(&format!(
            "; from byte {} on, {} bytes of {was} ({is} now)",
            found.first_byte, found.differing_bytes
        ));
        for value in found.values.iter().take(MOST_VALUES) {
            text.push_str(&format!("; {}", value_text(value)));
        }
    }
    text
}

/// Ends the verb with the code of the answer: a difference is one whatever could not be made.
fn told(report: &Report<'_>) -> Result<(), CliError> {
    let first = |wanted: fn(&Replayed) -> bool| report.nodes.iter().find(|node| wanted(node));
    let (answer, said) = match (first(differs), first(is_missing)) {
        (Some(node), _) => (
            Answer::Differs,
            format!("did not come out as it was, first at `{}`", node.node),
        ),
        (None, Some(node)) => (
            Answer::NotMade,
            format!("could not all be made again here, first `{}`", node.node),
        ),
        (None, None) => return Ok(()),
    };
    let diagnostic = Diagnostic::new(format!("run {} {said}", report.run));
    Err(CliError::Answered(answer, diagnostic))
}

#[cfg(test)]
mod tests {
    use marf_provenance::replay::DifferingOutput;

    use super::*;

    fn node(differs: &[&str], not_made: Option<NotMade>) -> Replayed {
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
            not_made,
        }
    }

    #[test]
    fn a_difference_counts_before_what_could_not_be_made_and_that_before_what_is_equal() {
        let made = || node(&[], None);
        let taken_over = || node(&[], Some(NotMade::TakenOver("it varies".to_owned())));
        let missing = || node(&[], Some(NotMade::NotMade("out of memory".to_owned())));
        let differing = || node(&["field"], None);
        for (nodes, code) in [
            (vec![], 0),
            (vec![made(), taken_over()], 0),
            (vec![made(), missing(), taken_over()], 9),
            (vec![missing(), differing(), made()], 7),
        ] {
            let told = told(&Report {
                run: 1,
                threads: 1,
                nodes: &nodes,
            });
            let found = told.map_or_else(|error| error.code(), |()| std::process::ExitCode::SUCCESS);
            assert_eq!(found, std::process::ExitCode::from(code), "{nodes:?}");
        }
    }
}
